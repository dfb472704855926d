"""Likelihood of a structure: prediction errors of a record, and the fit of a structure by them."""
