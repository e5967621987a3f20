"""Where one more contact closes a grasp (thesis, 2.2.2; A.6)."""
