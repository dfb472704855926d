"""Motion of the spool over a sample, and its prediction error."""
