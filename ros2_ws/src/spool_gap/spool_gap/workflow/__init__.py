"""Workflow of a gap analysis, from records to a result."""
