"""Second simulator: a plant of its own, its laws, its time stepping and its measuring channels."""
