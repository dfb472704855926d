"""Condition monitoring of a valve: resonance, drift, faults, events, alarms."""
