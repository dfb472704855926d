"""Faults of disks, clocks and processes, put on real recorders and their files."""
