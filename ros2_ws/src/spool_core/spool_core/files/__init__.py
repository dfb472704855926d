"""Files: bounded YAML, and writing that leaves nothing half done."""
