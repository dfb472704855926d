"""Acceptance of the choice: what must hold before it becomes a step."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.selection.all_windows import evidence_beyond_noise, evidence_in_noise
from spool_gap.selection.completeness import is_closed
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import evidence_of, lasting
from spool_gap.selection.state import SelectionState
from spool_gap.simulation.point import DELAY, GAIN

from .candidates import candidate, noted


def prefer_sensor_alone(_context: Context, state: SelectionState) -> SelectionState:
    """Gain or delay alone, where the choice let it free and adds nothing that counts jointly with it."""
    winner, step, fitting = state.chosen, state.hypothesis, state.fitting
    if winner is None or state.decided:
        return state
    known = (*step.effects, winner.newest)
    freed = tuple(name for name in winner.effects if name in (GAIN, DELAY) and name not in known)
    if not freed:
        return state
    effects = (*step.effects, *freed)
    point = replace(winner.point, active=fitting.terms_of(effects))
    alone = fitting.polished(fitting.fit(effects, [point], trials=step.trials))
    row = candidate(state, alone)
    if row.reason or not candidate(replace(state, accepted=alone), winner).reason:
        return state
    reason = f"jointly with {' and '.join(freed)} it adds nothing that counts"
    here = [own for own in state.ranking if own.jointly_with == step.effects]
    others = [
        replace(own, reason=reason) if set(freed) <= set(state.tried[own.key].effects) else own
        for own in here
        if own.id != freed[-1]
    ]
    ranking = (*(own for own in state.ranking if own not in here), *others)
    margin = evidence_of(fitting, step, winner)
    return noted(replace(state, ranking=ranking, chosen=alone, margin=margin), row)


def require_lasting_gain(_context: Context, state: SelectionState) -> SelectionState:
    """Refusal of a further effect whose gain the fit without it reaches from its numbers."""
    winner, step = state.chosen, state.hypothesis
    if winner is None or state.decided or not step.effects:
        return state
    again = lasting(state.fitting, step, winner)
    return state if again is None else replace(state.refitted(step, again), chosen=None)


def require_more_than_noise(_context: Context, state: SelectionState) -> SelectionState:
    """Refusal of a first effect that noise may look like, where the base leaves no more than noise."""
    winner, step = state.chosen, state.hypothesis
    if winner is None or step.effects:
        return state
    closed, state = is_closed(state, step)
    if not closed:
        return state
    (evidence,) = evidence_in_noise(state.fitting.simulation, step, [winner])
    if evidence >= evidence_beyond_noise(winner.newest):
        return state
    reason = "noise that the base rings with may leave as much"
    return replace(marked(state, winner.newest, reason=reason), chosen=None)


def accept(_context: Context, state: SelectionState) -> SelectionState:
    """Acceptance of the choice."""
    winner, step = state.chosen, state.hypothesis
    if winner is None:
        return state
    name = winner.newest
    row = next(own for own in reversed(state.ranking) if own.key == (name, step.effects))
    evidence = max(row.evidence, evidence_of(state.fitting, step, winner), state.margin)
    state = marked(state, name, evidence=evidence, accepted=True, reason="")
    return replace(state, accepted=winner, tried={**state.tried, (name, step.effects): winner})


def marked(state: SelectionState, name: str, **changes: object) -> SelectionState:
    """Return ``state`` with ``changes`` in the last row of the ranking for ``name`` in this round."""
    place = max(
        number for number, row in enumerate(state.ranking) if row.key == (name, state.hypothesis.effects)
    )
    ranking = list(state.ranking)
    ranking[place] = replace(ranking[place], **changes)  # type: ignore[arg-type]
    return replace(state, ranking=tuple(ranking))
