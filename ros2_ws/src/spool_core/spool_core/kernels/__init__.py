"""Compiled kernels: compilation, its cache and the processors."""
