"""History of a valve: baselines, trend and state over restarts."""
