"""What the parameters mean: resonance, drift, events."""
