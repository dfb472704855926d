"""Quality of records."""
