"""Field cases: records with the faults of real measuring chains, drawn without looking what they show."""
