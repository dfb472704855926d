"""The model gap: where simulation and measurement disagree, what is missing, and what remains."""
