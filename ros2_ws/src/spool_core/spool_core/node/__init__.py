"""Shared shell of the suite's nodes."""
