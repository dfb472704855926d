"""Console: options, progress, output files."""
