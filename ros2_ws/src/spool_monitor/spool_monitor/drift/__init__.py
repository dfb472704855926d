"""Drift of parameters: start values, sequential tests, and the causes of what moved together."""
