"""Six contacts with independent wrenches (thesis, 2.2 and 2.2.1; A.2 to A.5)."""
