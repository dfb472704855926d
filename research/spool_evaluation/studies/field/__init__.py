"""Field study: the gap workflow on records of real measuring chains."""
