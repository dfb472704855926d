"""Candidates for the next effect: screened, fitted by simulation, ranked with one weight, the best chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from spool_estimator.identification.least_squares import in_parallel

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.fitting.synchronised import holds_damper
from spool_gap.result import RankedHypothesis
from spool_gap.screening.screening import regression_candidates, residual_candidates
from spool_gap.selection.context import Context
from spool_gap.selection.evidence import evidence_of
from spool_gap.selection.joint_fit import jointly_fitted
from spool_gap.selection.sense import refusal
from spool_gap.selection.state import Candidate, SelectionState
from spool_gap.simulation.point import DELAY, GAIN

#: Hypotheses that are refined with the weight of the best one.
REFINED = 3


def screen_by_regression(context: Context, state: SelectionState) -> SelectionState:
    """Regression of the balance of forces: effects near the best one, or confusable with it."""
    found = regression_candidates(context.regressed, state.catalogue, state.hypothesis)
    return replace(state, screened=tuple(found))


def screen_residual(context: Context, state: SelectionState) -> SelectionState:
    """Residual of the free run: effects that explain most of it, where the regression is blunt."""
    found = residual_candidates(
        state.fitting.simulation, context.regressed, state.catalogue, state.hypothesis, state.screened
    )
    return replace(state, screened=(*state.screened, *found))


def fit_candidates(context: Context, state: SelectionState) -> SelectionState:
    """Fits of the screened effects, each jointly with what is accepted."""
    return replace(
        state, fits=tuple(in_parallel(lambda entry: jointly_fitted(context, state, entry), state.screened))
    )


def free_sensors(_context: Context, state: SelectionState) -> SelectionState:
    """Gain or delay as a candidate, where it pushes against its tolerance."""
    step = state.hypothesis
    found = [
        state.fitting.fit((*step.effects, name), [step.point], trials=step.trials)
        for name in (GAIN, DELAY)
        if name in step.fitted.at_bound and name not in step.effects
    ]
    return replace(state, fits=(*state.fits, *found))


def rank_candidates(_context: Context, state: SelectionState) -> SelectionState:
    """Ranking of the fits, the best of them refined."""
    return ranked(state, state.fits)


def follows(state: SelectionState) -> bool:
    """Whether runs can be synchronised to the measured motion, and are not yet."""
    return not state.synchronised and holds_damper(state.fitting)


def note_candidates(_context: Context, state: SelectionState) -> SelectionState:
    """Rows of the ranking for all candidates."""
    for entry in state.candidates:
        state = noted(state, entry)
    return state


def choose_candidate(_context: Context, state: SelectionState) -> SelectionState:
    """Choice of the candidate with the most evidence that is not refused."""
    sensible = [entry.hypothesis for entry in state.candidates if not entry.reason]
    return replace(state, chosen=state.fitting.polished(sensible[0])) if sensible else state


def ranked(state: SelectionState, fits: Sequence[Hypothesis]) -> SelectionState:
    """Return ``state`` with ``fits`` as candidates, ranked with one weight: what the best of them leaves.

    What is accepted is fitted on with that, too: what it still gains on its own is no evidence for an effect.
    """
    if not fits:
        return replace(state, candidates=())
    fitting, step = state.fitting, state.hypothesis
    fits, own = sorted(fits, key=lambda entry: entry.cost), step
    if fits[0].has_jumps:
        fitting = fitting.over(fitting.simulation.sampled_for(fits[0].point))
        own, *fits = (fitting.measured(entry) for entry in (own, *fits))
    fitting = fitting.weighed_by(fits[0])
    fits = sorted(fits, key=lambda entry: entry.cost)
    fits = in_parallel(lambda entry: fitting.polished(entry, rounds=5), fits[:REFINED]) + fits[REFINED:]
    own = fitting.scored(own)
    closer = fitting.polished(own, rounds=5)
    own = min(own, closer, key=lambda entry: entry.cost)
    state = replace(state.refitted(step, own), fitting=fitting)
    found = [candidate(state, fitting.scored(entry)) for entry in fits]
    return replace(state, candidates=tuple(sorted(found, key=lambda entry: -entry.evidence)))


def candidate(state: SelectionState, hypothesis: Hypothesis) -> Candidate:
    """Return ``hypothesis`` with its evidence over what is accepted and why it is refused."""
    evidence = evidence_of(state.fitting, state.hypothesis, hypothesis)
    reason = refusal(state.fitting, state.hypothesis, hypothesis, evidence, state.noise_floor)
    return Candidate(hypothesis, evidence, reason)


def noted(state: SelectionState, entry: Candidate) -> SelectionState:
    """Return ``state`` with ``entry`` in its ranking."""
    one, effects = entry.hypothesis, state.hypothesis.effects
    row = RankedHypothesis(
        one.newest, effects, state.fitting.nrmse(one), entry.evidence, one.free_values, reason=entry.reason
    )
    return replace(state, ranking=(*state.ranking, row), tried={**state.tried, (one.newest, effects): one})
