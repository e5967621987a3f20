"""Measurements of accuracy, effects, cost and hard cases, and comparisons with other programs."""
