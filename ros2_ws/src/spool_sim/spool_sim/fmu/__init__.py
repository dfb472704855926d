"""Export of a valve with its model as a Functional Mock-up Unit."""
