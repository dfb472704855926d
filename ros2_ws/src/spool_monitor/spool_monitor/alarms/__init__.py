"""Alarms and events: their life cycle, codes, remedies and services."""
