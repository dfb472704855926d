"""Terminal view of running valves: what is heard of them, rows, alarms, keys of an operator."""
