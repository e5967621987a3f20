"""The seven contacts with the largest margin, and a bound for all others (thesis, 5.1)."""
