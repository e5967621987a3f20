"""Compiled copies of the arms: four of them at a time, with nothing of Python in between."""
