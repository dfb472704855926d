"""Nuisances of the measuring chain that a record shows without any model."""
