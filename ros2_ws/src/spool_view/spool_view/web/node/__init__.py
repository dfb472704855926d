"""Node ``page``: listens to valves and asks their services."""
