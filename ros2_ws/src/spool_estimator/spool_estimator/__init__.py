"""Online estimation of a valve's parameters from two accelerometers."""
