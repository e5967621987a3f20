"""Form closure and immobility of any number of contacts (thesis, 2.1)."""
