"""Simulation: setup, run, events, the certificate of the accuracy, and many runs in threads."""
