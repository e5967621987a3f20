"""Grasps constructed for classes of bodies, or searched (thesis, 2.2.3)."""
