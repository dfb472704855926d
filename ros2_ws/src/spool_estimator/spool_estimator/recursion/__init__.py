"""Recursive least squares: conditioning, forgetting, windows."""
