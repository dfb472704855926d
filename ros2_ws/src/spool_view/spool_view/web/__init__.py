"""Operator's page: running valves in a browser on this host, and an operator's acts with a token."""
