"""What commands print with: consoles, tables, progress bars."""
