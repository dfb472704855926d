"""Which parameters this machine has, from two accelerometers."""
