"""Operator: token, log of acts, limits."""
