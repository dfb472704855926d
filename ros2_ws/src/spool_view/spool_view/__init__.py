"""Running valves for people and plant systems: page, viewer layouts, OPC UA."""
