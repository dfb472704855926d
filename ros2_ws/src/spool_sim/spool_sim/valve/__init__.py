"""The valve: its description, oil, lubrication and plausibility."""
