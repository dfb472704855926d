"""The terminal: options, progress, output files."""
