"""Checks: whether a record can be analysed at all."""
