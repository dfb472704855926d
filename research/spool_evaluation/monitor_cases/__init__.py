"""Scenarios whose truth is known, and how the monitor does on them."""
