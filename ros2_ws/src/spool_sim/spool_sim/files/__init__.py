"""Files of users: YAML within bounds, and its validation."""
