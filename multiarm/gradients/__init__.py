"""Derivatives of whole runs: forward sensitivities, adjoint gradients."""
