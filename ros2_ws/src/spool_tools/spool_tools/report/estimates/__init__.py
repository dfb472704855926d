"""Estimates: what the evidence of a report is drawn from, as arrays."""
