"""Files of users and their validation."""
