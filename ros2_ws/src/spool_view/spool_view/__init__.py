"""Running valves for people: page, viewer layouts."""
