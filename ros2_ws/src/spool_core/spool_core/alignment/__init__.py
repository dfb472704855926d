"""Alignment of two sensors that are sampled one message at a time: onto one grid, as blocks."""
