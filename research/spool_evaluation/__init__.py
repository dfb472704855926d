"""Evaluation: studies, benchmarks against peers and the paper; nothing that runs on a machine needs it."""
