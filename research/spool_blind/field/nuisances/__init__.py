"""Nuisances of field cases: what sensors, cables, filters and loggers do to a record."""
