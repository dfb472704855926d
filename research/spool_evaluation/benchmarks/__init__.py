"""Benchmarks against peers, on the same work in one run. Each is a module with ``run``."""
