"""Importance of an effect: by how much it changes the spool's acceleration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spool_gap.registry import EFFECTS
from spool_gap.selection.state import SelectionState


def share_of(state: SelectionState, name: str) -> float:
    """Return the rms by which the effect ``name`` changes the simulated acceleration, over the measured rms.

    The accepted hypothesis is run with and without it over the held-out windows, all other numbers as they
    are. What is of the channels alone, as gain and delay, has tolerances of its own: infinite.
    """
    final, simulation = state.hypothesis, state.fitting.simulation
    if not EFFECTS[name].terms:
        return float("inf")
    others = [own for own in final.effects if own != name]
    bare = replace(final.point, active=state.fitting.terms_of(others))
    held = simulation.held_out
    with_it, without = simulation.errors([final.point], held), simulation.errors([bare], held)
    changed = sum(float(np.sum((one - other) ** 2)) for one, other in zip(with_it, without, strict=True))
    measured = sum(float(np.sum(row**2)) for row in simulation.measured(held))
    return float(np.sqrt(changed / max(measured, 1e-300)))
