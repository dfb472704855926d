"""Excitation: body acceleration over time."""
