"""Signals of records: zero-phase filters, spectra, noise of the channels, clipping."""
