"""Acceptance of the choice: what must hold before it becomes a step."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.report.sentence import GROWS, refused_for_growth
from spool_gap.result import Change
from spool_gap.selection.all_windows import evidence_beyond_noise, evidence_in_noise
from spool_gap.selection.completeness import is_closed
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import evidence_of, lasting
from spool_gap.selection.state import SelectionState


def require_lasting_gain(_context: Context, state: SelectionState) -> SelectionState:
    """Refusal of a further effect whose gain the fit without it reaches from its numbers."""
    winner, step = state.chosen, state.hypothesis
    if winner is None or not step.effects:
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
    evidence = max(row.evidence, evidence_of(state.fitting, step, winner))
    state = marked(state, name, evidence=evidence, accepted=True, reason="")
    return replace(state, accepted=winner, tried={**state.tried, (name, step.effects): winner})


def refuse_growth(state: SelectionState) -> tuple[SelectionState, tuple[str, ...]]:
    """Return ``state`` without effects that make the held-out error larger than the base's.

    The evidence for an effect is weighed by the spectrum of what is left, so the plain error may grow.
    With it come the sentences that say what was refused and why.
    """
    final, errors = state.hypothesis, [state.fitting.nrmse(step) for step in state.steps]
    after = state.fitting.nrmse(final)
    if not final.effects or after <= errors[0]:
        return state, ()
    place = max(number for number, error in enumerate(errors) if error <= errors[0])
    kept = state.steps[place]
    refused = [name for name in final.effects if name not in kept.effects]
    text = refused_for_growth(refused, errors[place], after)
    ranking = tuple(
        replace(row, accepted=False, reason=GROWS) if row.accepted and row.id in refused else row
        for row in state.ranking
    )
    change = Change("refuse_growth", final.effects, kept.effects)
    return replace(
        state, accepted=kept, steps=state.steps[: place + 1], ranking=ranking, trace=(*state.trace, change)
    ), (text,)


def marked(state: SelectionState, name: str, **changes: object) -> SelectionState:
    """Return ``state`` with ``changes`` in the last row of the ranking for ``name`` in this round."""
    place = max(
        number for number, row in enumerate(state.ranking) if row.key == (name, state.hypothesis.effects)
    )
    ranking = list(state.ranking)
    ranking[place] = replace(ranking[place], **changes)  # type: ignore[arg-type]
    return replace(state, ranking=tuple(ranking))
