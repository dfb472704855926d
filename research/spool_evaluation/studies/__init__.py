"""Studies over many records: how often the suite is right. Each is a module with ``run``."""
