"""Other start of the selection: from the effect that is confusable with the first one.

A first effect, alone, takes what belongs to two; jointly with the second, a confusable one may fit better.
"""

from __future__ import annotations

from dataclasses import replace

from spool_gap.registry import EFFECTS
from spool_gap.result import RankedHypothesis
from spool_gap.selection.completeness import is_closed
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import evidence_by_numbers
from spool_gap.selection.state import SelectionState
from spool_gap.thresholds import THRESHOLDS

from .growth import grow


def try_other_start(context: Context, state: SelectionState) -> SelectionState:
    """Choice of what grows from a confusable first effect, if what was found leaves a gap and that less."""
    found = state.hypothesis
    if not found.effects:
        return state
    closed, state = is_closed(state, found)
    first = next((row for row in state.ranking if row.accepted and not row.jointly_with), None)
    if closed or first is None or first.id not in EFFECTS:
        return state
    second = _confusable(state, first)
    if second is None:
        return state
    start = state.fitting.polished(state.tried[second.id, ()])
    other = grow(
        context,
        replace(
            state,
            accepted=start,
            steps=(*state.steps[:1], start),
            ranking=tuple(
                replace(row, accepted=row is second) for row in state.ranking if not row.jointly_with
            ),
            catalogue=tuple(entry for entry in state.catalogue if entry.id != first.id),
        ),
    )
    return _better(state, other, first.id)


def _confusable(state: SelectionState, first: RankedHypothesis) -> RankedHypothesis | None:
    """Return the row of the best effect confusable with the ``first``, if it was nearly as good."""
    confusable = {*EFFECTS[first.id].confusable_with, *EFFECTS[first.id].replaces}
    rows = [row for row in state.ranking if not (row.jointly_with or row.accepted or row.reason)]
    least = THRESHOLDS.confusable_evidence * first.evidence
    rows = [row for row in rows if row.id in confusable and row.evidence > least]
    return max(rows, key=lambda row: row.evidence, default=None)


def _better(state: SelectionState, other: SelectionState, first: str) -> SelectionState:
    """Return ``other``, or ``state`` with what ``other`` tried, by the weight of what leaves less."""
    fitting, one, two = other.fitting, state.hypothesis, other.hypothesis
    least = min((one, two), key=fitting.nrmse)
    if least.has_jumps:
        fitting = fitting.over(fitting.simulation.sampled_for(least.point))
    one, two = fitting.measured(one), fitting.measured(two)
    weighed = fitting.weighed_by(one if least is state.hypothesis else two)
    one, two = weighed.scored(one), weighed.scored(two)
    evidence = evidence_by_numbers(weighed, one, two)
    if evidence > max(THRESHOLDS.evidence, THRESHOLDS.clearly * two.cost):
        other = replace(other.refitted(other.hypothesis, two), fitting=weighed)
        return replace(other, overruled={**other.overruled, first: evidence})
    apart = other.synchronised and not state.synchronised
    fitting, judging = (state.fitting, state.judging) if apart else (weighed, other.judging)
    state = state.refitted(state.hypothesis, fitting.measured(state.hypothesis))
    return replace(
        state.over(fitting), judging=judging, tried=other.tried, overruled=other.overruled, remaining=None
    )
