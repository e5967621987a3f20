"""Bodies bounded by plane faces, and their classes (thesis, 2.2.3)."""
