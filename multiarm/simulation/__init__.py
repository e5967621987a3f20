"""Simulation: setup, run, events, and the certificate of the accuracy."""
