"""Host: estimators and monitors of any number of valves in a few processes."""
