"""A trajectory as one page."""
