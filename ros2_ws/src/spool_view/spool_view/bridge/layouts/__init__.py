"""Layouts of viewers, made of the topics of valves."""
