"""Paper: its series, models, figures and tables on simulated data."""
