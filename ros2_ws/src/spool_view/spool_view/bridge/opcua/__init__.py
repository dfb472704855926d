"""OPC UA server: state and alarms of valves for plant systems, read only."""
