"""The effects that the analysis can name: one file each."""
