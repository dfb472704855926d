"""Screening: which effects are worth simulating."""
