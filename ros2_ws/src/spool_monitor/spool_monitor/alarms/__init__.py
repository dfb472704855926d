"""Alarms: their life cycle after ISA-18.2, and all those of a valve."""
