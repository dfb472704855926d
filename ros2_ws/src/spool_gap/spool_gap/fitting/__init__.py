"""Fitting of hypotheses by their free runs."""
