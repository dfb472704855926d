"""The effects that the analysis can name: one class each, in files by family."""
