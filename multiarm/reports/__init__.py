"""A trajectory as one HTML page."""
