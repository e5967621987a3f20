"""A run: setup, driver, certificate."""
