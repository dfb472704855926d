"""Completeness of a hypothesis: whether what it leaves over whole windows is noise."""

from __future__ import annotations

from dataclasses import replace

from spool_gap.fitting.hypothesis import Hypothesis
from spool_gap.screening.remainder import remainder
from spool_gap.simulation.noise_floor import noise_floor
from spool_gap.thresholds import THRESHOLDS

from .state import Remaining, SelectionState
from .windows import median_excess


def looked_at(state: SelectionState, hypothesis: Hypothesis) -> tuple[Remaining, SelectionState]:
    """Return what ``hypothesis`` leaves over whole windows, and ``state`` that knows it."""
    if state.remaining is not None and state.remaining.fitted is hypothesis.fitted:
        return state.remaining, state
    judging, point = state.judging, hypothesis.point
    if hypothesis.has_jumps:
        judging = judging.sampled_for(point)
    training, held = judging.training, judging.held_out
    errors = judging.errors([point], [*training, *held])
    train, other = errors[: len(training)], errors[len(training) :]
    left, before = float(judging.nrmse(other, held)[0]), state.fitting.nrmse(state.steps[0])
    floor = noise_floor(judging, point, other)
    excess = min(left / floor.nrmse, median_excess(other, floor.errors))
    counts = left**2 - floor.nrmse**2 > (THRESHOLDS.predictable_of_gap * before) ** 2
    predictable = counts and excess > THRESHOLDS.closed  # so much is no noise
    if not predictable:
        judging = judging.weighed_by(train)
        rest = remainder(judging, point, train, other)
        predictable = rest.counts(left, before, kinks=hypothesis.has_kinks)
    found = Remaining(hypothesis.fitted, floor.nrmse, excess, counts=counts, predictable=predictable)
    return found, replace(state, judging=judging, remaining=found)


def is_closed(state: SelectionState, hypothesis: Hypothesis) -> tuple[bool, SelectionState]:
    """Return whether ``hypothesis`` leaves no gap worth another law, and ``state`` that knows it."""
    remaining, state = looked_at(state, hypothesis)
    return remaining.is_noise(THRESHOLDS.closed), state


def is_complete(state: SelectionState, hypothesis: Hypothesis) -> tuple[bool, SelectionState]:
    """Return whether ``hypothesis`` leaves nothing to look for, and ``state`` that knows it."""
    remaining, state = looked_at(state, hypothesis)
    kinks = hypothesis.has_kinks
    return remaining.is_noise(THRESHOLDS.at_noise_floor if kinks else THRESHOLDS.smooth_at_noise_floor), state
