"""Gap analysis by the evidence of all structures: one model, one likelihood, one decision.

``./spool study field --evidence`` runs it over field cases. ``./spool gap`` does not use it yet: on records
with strong friction it still calls something unexplained that is not.
"""
