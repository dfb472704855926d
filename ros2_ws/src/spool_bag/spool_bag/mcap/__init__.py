"""MCAP files, record by record."""
