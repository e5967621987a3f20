"""Dynamics of robots: Pinocchio and compiled copies, (q, v) -> terms of the equations of motion."""
