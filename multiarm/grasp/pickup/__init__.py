"""Picking a body up from the floor by tilting it about an edge."""
