"""Physics of a spool in a vibrating valve body."""
