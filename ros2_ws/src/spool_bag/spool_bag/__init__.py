"""Bags: recorder, reader, recovery, import and export."""
