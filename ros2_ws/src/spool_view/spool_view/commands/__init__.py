"""Commands of this package: one module each, found by its name."""
