"""Packaging: a Debian package, and the list of what is in it."""
