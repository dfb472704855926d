"""Pictures of laws, effects and convergence for the documentation."""
