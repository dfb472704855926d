"""Simulated operation of valves over many days: how often the monitor is wrong, and how late it is right."""
