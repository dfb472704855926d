"""Catalogue: which bags there are, of which machine and valve."""
