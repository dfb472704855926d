"""The paper's series, models, figures and tables on simulated data."""
