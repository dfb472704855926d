"""Format of a bag: message bytes, message definitions and ``metadata.yaml``."""
