"""Desk tools: changed conditions, planned records, records of several set-ups, export as FMU."""
