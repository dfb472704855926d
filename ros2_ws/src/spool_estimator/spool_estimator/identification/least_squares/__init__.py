"""Least squares: unknowns, their descent, what the data tell of them."""
