"""Bridges from valves to viewers and plant systems."""
