"""Small effects, which half of the data does not show: fitted to all of it, judged by their BIC penalty.

Held-out data guards against numbers that fit chance, at the cost of half of what is known. Where nothing was
found that way, the likelihood ratio over all windows says more (Schwarz's criterion).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from spool_estimator.identification.least_squares import in_parallel

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.result import RankedHypothesis
from spool_gap.screening.screening import small_candidates
from spool_gap.selection.all_windows import AllWindows, evidence_beyond_noise, evidence_in_noise
from spool_gap.selection.context import Context
from spool_gap.selection.sense import senseless
from spool_gap.selection.state import Candidate, SelectionState
from spool_gap.thresholds import THRESHOLDS


def find_small_effect(context: Context, state: SelectionState) -> SelectionState:
    """Small effect that all windows show jointly, where held-out ones show none."""
    if state.hypothesis.effects:
        return state
    fitting = state.fitting
    candidates = _candidates(context, state)
    if not candidates:
        return state
    best = max(range(len(candidates)), key=lambda number: candidates[number].evidence)
    for number, entry in enumerate(candidates):
        hypothesis = fitting.measured(entry.hypothesis)
        # All windows named it; its numbers come from those that are fitted, so that the others can judge.
        hypothesis = fitting.polished(hypothesis) if number == best else hypothesis
        name, accepted = hypothesis.newest, number == best and not entry.reason
        values = entry.hypothesis.own_values
        row = RankedHypothesis(
            name, (), fitting.nrmse(hypothesis), entry.evidence, values, accepted, entry.reason
        )
        state = replace(
            state,
            ranking=(*(known for known in state.ranking if known.id != name), row),
            tried={**state.tried, (name, ()): hypothesis},
        )
        if accepted:
            state = replace(state, accepted=hypothesis, steps=(*state.steps, hypothesis))
    return state


def _candidates(context: Context, state: SelectionState) -> list[Candidate]:
    """Return small effects fitted to all windows, with their evidence and why they are refused."""
    fitting = state.fitting.over(AllWindows.of(state.fitting.simulation))
    start = fitting.fit((), [state.hypothesis.point])
    fitting = fitting.weighed_by(start)
    start = fitting.polished(start, rounds=10)
    screened = small_candidates(fitting.simulation, context.regressed, state.catalogue, start)
    fits = in_parallel(lambda entry: _fitted(fitting, start, entry.effect.id, entry.values), screened)
    found = []
    for entry, fit, evidence in zip(
        screened, fits, evidence_in_noise(fitting.simulation, start, fits), strict=True
    ):
        fall = fitting.nrmse(start) ** 2 - fitting.nrmse(fit) ** 2
        reason = _refusal(fit, evidence, fall)
        found.append(Candidate(replace(fit, trials={entry.effect.id: entry.trial}), evidence, reason))
    return found


def _refusal(fit: Hypothesis, evidence: float, fall: float) -> str:
    """Return why ``fit``, with that evidence and fall of the share of power left, is none, or nothing."""
    if evidence < evidence_beyond_noise(fit.newest):
        return "it does not close the gap significantly"
    if fall < THRESHOLDS.smallest**2:
        return "it is too small to be distinguished from errors of the simulation"
    return senseless(fit, fit.newest)


def _fitted(fitting: Fitting, start: Hypothesis, name: str, values: Mapping[str, float]) -> Hypothesis:
    """Return ``start`` with the effect ``name``, fitted from ``values`` to all windows."""
    point = replace(start.point, active=fitting.terms_of((name,)), values={**start.point.values, **values})
    return fitting.polished(fitting.fit((name,), [point]), rounds=10)
