"""Sliding laws that do not contain each other, distinguished by all windows.

Mixed and Stribeck friction are alike over most speeds: held-out windows alone decide by chance. Neither is
the richer one, so that the likelihood over all windows counts, less a BIC penalty for each number (Schwarz).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import in_parallel

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.selection.all_windows import AllWindows
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import bic_penalty, in_windows
from spool_gap.selection.friction_laws import is_sliding, with_law
from spool_gap.selection.sense import senseless
from spool_gap.selection.state import SelectionState
from spool_gap.selection.windows import trimmed_sum
from spool_gap.thresholds import THRESHOLDS

from .whole_windows import is_fitted, with_final

Array = NDArray[np.float64]

#: Starts that are followed, and for how long: fits of these laws end in several local minima.
FOLLOWED, ROUNDS = 4, 3


def compare_sliding_laws(context: Context, state: SelectionState) -> SelectionState:
    """Choice of the sliding law that all windows show, in place of one that they show less."""
    step = best = state.hypothesis
    if not is_fitted(state, step):
        return state
    for present in filter(_falls_with_speed, step.effects):
        for name in _others(state, present):
            other = with_law(context, state, step, present, name, tries=FOLLOWED, rounds=ROUNDS)
            if other is None or too_far(step.costs, other.costs):
                continue
            other, margin = _compared(state, step, other)
            if senseless(other, name):
                continue
            if senseless(step, present):
                margin = abs(margin)
            loser = present if margin > 0.0 else name
            state = replace(state, overruled={**state.overruled, loser: abs(margin)})
            if margin > 0.0:
                state = _overrule(state, present, name)
                # All windows named it; its numbers come from those that are fitted, the others judge.
                best = state.fitting.polished(state.fitting.measured(other))
    return with_final(state, best)


def _falls_with_speed(name: str) -> bool:
    """Whether ``name`` is a law of sliding friction with speeds in it."""
    return is_sliding(name) and any(EFFECTS[name].speeds_to_try(1.0))


def _others(state: SelectionState, present: str) -> list[str]:
    """Return the laws like ``present`` that neither contain it nor are contained in it."""
    names = sorted(entry.id for entry in state.catalogue if entry.id != present)
    return [
        name
        for name in filter(_falls_with_speed, names)
        if name not in EFFECTS[present].replaces and present not in EFFECTS[name].replaces
    ]


def _compared(state: SelectionState, one: Hypothesis, other: Hypothesis) -> tuple[Hypothesis, float]:
    """Return ``other`` fitted to all windows, and its evidence over ``one`` in all but extreme ones."""
    everything = AllWindows.of(state.fitting.simulation)
    fitting = state.fitting.over(everything.sampled_for(one.point))
    both = [step.at(step.point) for step in (one, other)]
    one, other = in_parallel(lambda step: fitting.polished(fitting.measured(step)), both)
    numbers = len(other.fitted.free) - len(one.fitted.free)
    return other, trimmed_sum(one.costs - other.costs) - bic_penalty(fitting) * numbers


def too_far(costs: Array, rival: Array) -> bool:
    """Whether a law is too far behind another one on held-out windows to catch up.

    Args:
        costs: weighed sum of squares of the law that is ahead, one a window, shape (w,).
        rival: of the other, which is hardly fitted yet.
    """
    behind = float(rival.sum() / costs.sum())
    if THRESHOLDS.too_far_everywhere < behind <= THRESHOLDS.too_far:
        return costs.size >= THRESHOLDS.fewest_windows and in_windows(rival - costs, behind - 1.0)
    return behind > THRESHOLDS.too_far


def _overrule(state: SelectionState, present: str, name: str) -> SelectionState:
    """Return ``state`` whose ranking says that ``name`` was taken in place of ``present``."""
    rows = [row for row in state.ranking if row.id == present and row.accepted]
    lost = f"{name.replace('_', ' ')} fits all windows better"
    won = {(name, row.jointly_with) for row in rows}
    return replace(
        state,
        ranking=tuple(
            replace(row, accepted=False, reason=lost)
            if row in rows
            else replace(row, accepted=True, reason="")
            if row.key in won
            else row
            for row in state.ranking
        ),
    )
