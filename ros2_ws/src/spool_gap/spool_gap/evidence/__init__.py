"""Gap analysis of accelerations by the evidence of all structures: one likelihood, one decision."""
