"""View of running valves: what was heard of them, and what browsers are shown."""
