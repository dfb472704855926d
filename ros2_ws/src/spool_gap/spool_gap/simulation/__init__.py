"""Simulation of hypotheses: free runs over segments of the records."""
