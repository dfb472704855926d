"""Time integration of compositions of force terms."""
