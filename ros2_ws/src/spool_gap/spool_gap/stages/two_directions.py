"""One friction force for each direction, where the start from rest shows that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.result import RankedHypothesis
from spool_gap.selection.context import Context
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.start_from_rest import Asymmetry, asymmetry
from spool_gap.thresholds import THRESHOLDS

ONE, TWO = "coulomb_friction", "asymmetric_friction"


def split_by_direction(_context: Context, state: SelectionState) -> SelectionState:
    """Two forces of friction in place of one, with the evidence of one and of the start from rest."""
    contained = EFFECTS[TWO].replaces
    one = next((row.evidence for row in state.ranking if row.accepted and row.id in contained), 0.0)
    return split(state, one)


def split(state: SelectionState, one: float) -> SelectionState:
    """Return ``state`` with two forces where a start from rest shows them; ``one``: evidence for one."""
    step = state.hypothesis
    shown = _shown(state.fitting, step) if ONE in step.effects else None
    if shown is None:
        return state
    better = state.fitting.measured(_with_two_forces(state.fitting, step, shown))
    values = {name: better.point.values[name] for name in EFFECTS[TWO].fitted}
    others = step.effects[: step.effects.index(ONE)]
    error = state.fitting.nrmse(better)
    row = RankedHypothesis(TWO, others, error, one + shown.evidence, values, accepted=True)
    return replace(state, accepted=better, steps=(*state.steps, better), ranking=(*state.ranking, row))


def _shown(fitting: Fitting, step: Hypothesis) -> Asymmetry | None:
    """Return the asymmetry that the start of a record shows clearly, if one does."""
    for stretch in fitting.stretches:
        found = asymmetry(fitting.simulation, stretch, step.point, fitting.base, fitting.valve)
        if found is None or found.evidence < THRESHOLDS.two_forces_evidence:
            continue
        least = max(THRESHOLDS.two_forces_ratio, THRESHOLDS.two_forces_deviations * found.deviation)
        if abs(found.ratio) >= least:
            return found
    return None


def _with_two_forces(fitting: Fitting, step: Hypothesis, found: Asymmetry) -> Hypothesis:
    effects = tuple(TWO if name == ONE else name for name in step.effects)
    old = step.fitted
    mean, spread = old.point.values["coulomb_force"], old.deviations["coulomb_force"]
    forces = {"forward_force": (1.0 + found.ratio) * mean, "backward_force": (1.0 - found.ratio) * mean}
    deviation = math.hypot(spread, mean * found.deviation)
    names = [unknown.name for unknown in old.free]
    place = names.index("coulomb_force")
    kept = [number for number in range(len(names)) if number != place]
    free = tuple(old.free[number] for number in kept)
    free += tuple(replace(old.free[place], name=name) for name in forces)
    values = {**old.point.values, **forces}
    correlation = old.correlation[np.ix_([*kept, place, place], [*kept, place, place])]
    # Each force has the error of their mean and, with opposite signs, that of their difference.
    of_mean = spread / deviation if deviation > 0.0 else 1.0
    correlation[len(kept) :, : len(kept)] *= of_mean
    correlation[: len(kept), len(kept) :] *= of_mean
    correlation[-2:, -2:] = 2.0 * of_mean**2 - 1.0
    np.fill_diagonal(correlation, 1.0)
    fitted = replace(
        old,
        point=replace(old.point, active=fitting.terms_of(effects), values=values),
        free=free,
        deviations={**old.deviations, **dict.fromkeys(forces, deviation)},
        correlation=correlation,
    )
    return replace(step, effects=effects, fitted=fitted)
