"""Noise of the channels, from the record itself."""
