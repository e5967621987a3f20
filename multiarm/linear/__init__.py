"""Linearised systems: minimal coordinates, modes, equilibria."""
