"""Formats of files: one module a format, found by name."""
