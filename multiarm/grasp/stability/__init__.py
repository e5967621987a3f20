"""Displacements that a grasp bears (thesis, 2.3)."""
