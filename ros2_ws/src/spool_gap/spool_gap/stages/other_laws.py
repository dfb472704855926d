"""Other friction laws in place of the one that was found first, jointly with other effects.

Alone, a law takes what belongs to another effect; jointly with that one, another law may fit better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from spool_identification.least_squares.parallel import in_parallel

from spool_gap.fitting.equivalent_start import slides
from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.registry import EFFECTS, FRICTIONS
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import beats_simpler, evidence_by_numbers
from spool_gap.selection.friction_laws import with_law
from spool_gap.selection.sense import senseless
from spool_gap.selection.state import SelectionState
from spool_gap.thresholds import THRESHOLDS


def try_other_laws(context: Context, state: SelectionState) -> SelectionState:
    """Choice of another law of friction where that does better jointly with the other effects.

    Not by synchronised runs: free runs in the end distinguish laws of friction better.
    """
    return state if state.synchronised else swapped_law(context, state)


def swapped_law(context: Context, state: SelectionState) -> SelectionState:
    """Return ``state`` with the best law of friction jointly with the other accepted effects."""
    step = state.hypothesis
    present = next((name for name in step.effects if name in FRICTIONS and name in EFFECTS), None)
    if present is None or len(step.effects) < 2:
        return state

    def in_place(name: str) -> Hypothesis | None:
        other = with_law(context, state, step, present, name)
        if other is None:
            return None
        most = THRESHOLDS.near_cost_senseless if senseless(other, name) else THRESHOLDS.near_cost
        return state.fitting.polished(other) if other.cost < most * step.cost else other

    best = step
    names = sorted(FRICTIONS - {present})
    for name, other in zip(names, in_parallel(in_place, names), strict=True):
        if other is not None and _is_better(state, best, other, name) and not senseless(other, name):
            best = other
    if best is step:
        return state
    overruled: Mapping[str, float] = {**state.overruled, present: abs(step.cost - best.cost)}
    state = replace(state, accepted=best, overruled=overruled)
    first = slides(best.effects[step.effects.index(present)]) and not slides(present)
    return swapped_law(context, state) if first else state


def _is_better(state: SelectionState, best: Hypothesis, other: Hypothesis, name: str) -> bool:
    law = next(entry for entry in best.effects if entry in FRICTIONS)
    if name in EFFECTS[law].replaces:
        return not beats_simpler(state.fitting, other, best)
    if law in EFFECTS[name].replaces:
        return beats_simpler(state.fitting, best, other)
    numbers = len(other.fitted.free) - len(best.fitted.free)
    clear = THRESHOLDS.clearly * best.cost if numbers > 0 else 0.0
    return evidence_by_numbers(state.fitting, best, other) > clear
