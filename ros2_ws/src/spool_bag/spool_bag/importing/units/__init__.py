"""Units of channels and their headers."""
