"""Time integration on the configuration manifold: methods as data, one stepper, dense output."""
