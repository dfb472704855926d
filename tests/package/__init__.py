"""Trial of the package on a machine that has nothing of it."""
