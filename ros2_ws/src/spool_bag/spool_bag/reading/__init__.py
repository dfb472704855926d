"""Reading of bags by acquisition time."""
