"""OPC UA server for plant systems: state and alarms of all valves."""
