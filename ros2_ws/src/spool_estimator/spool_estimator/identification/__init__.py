"""Offline identification: records, free runs, least squares, intervals."""
