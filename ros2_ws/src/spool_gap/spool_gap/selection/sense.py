"""Plausibility of a hypothesis: why its numbers, or the way it helps, make no sense."""

from __future__ import annotations

import math

import numpy as np

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.registry import EFFECTS
from spool_gap.result import GapSettings
from spool_gap.simulation.point import DELAY, GAIN
from spool_gap.simulation.segments import span_of
from spool_gap.thresholds import THRESHOLDS

from .evidence import enough, gain_in_most


def refusal(fitting: Fitting, one: Hypothesis, other: Hypothesis, evidence: float, noise_floor: float) -> str:
    """Reason why ``other`` is not taken in place of ``one``, or an empty string.

    Args:
        fitting: windows and weight by which both were measured.
        one, other: without and with a further effect.
        evidence: for ``other``.
        noise_floor: error that noise leaves of ``one``.
    """
    if evidence < enough(one.cost):
        return "it does not close the gap significantly"
    if too_small(fitting, one, other, noise_floor):
        return "it is too small to be distinguished from errors of the simulation"
    if one.effects and _by_chance(fitting, one, other, noise_floor):
        return "it helps in few windows only, as chance does where the motion is sensitive"
    name = other.newest
    if name in (GAIN, DELAY):
        room = THRESHOLDS.beyond_tolerance * other.fitted.deviations[name]
        if abs(other.point.get(name)) < tolerance(fitting.settings, name) + room:
            return "it is not significantly beyond its tolerance"
        return ""
    return senseless(other, name)


def too_small(fitting: Fitting, one: Hypothesis, other: Hypothesis, noise_floor: float) -> bool:
    """Whether ``other`` explains too little of the acceleration, in all windows and in the median one."""
    for error in (Fitting.nrmse, median_nrmse):
        before, after = error(fitting, one), error(fitting, other)
        least = max(THRESHOLDS.smallest**2, _least_share(one, before, noise_floor) * before**2)
        if not before**2 - after**2 < least:
            return False
    return True


def _least_share(one: Hypothesis, before: float, noise_floor: float) -> float:
    """Return the share of the power ``before`` that an effect jointly with those of ``one`` must explain."""
    if not one.effects:
        return 0.0
    open_share = THRESHOLDS.further_open_share * max(0.0, 1.0 - (noise_floor / before) ** 2)
    return min(THRESHOLDS.further_share, open_share)


def _by_chance(fitting: Fitting, one: Hypothesis, other: Hypothesis, noise_floor: float) -> bool:
    """Whether ``other`` helps ``one`` in few windows only, and not down to the noise floor."""
    name = other.newest
    local = name not in EFFECTS or EFFECTS[name].localised or EFFECTS[name].follows_time
    closes = fitting.nrmse(other) < THRESHOLDS.at_noise_floor * noise_floor
    return not (local or closes) and gain_in_most(one, other) < THRESHOLDS.evidence


def median_nrmse(fitting: Fitting, hypothesis: Hypothesis) -> float:
    """Held-out nrmse in the median window: those in which the motion goes another way count no more."""
    measured = fitting.simulation.measured(fitting.simulation.held_out)
    shares = [
        float(np.sum(error**2)) / max(1e-30, float(np.sum(own**2)))
        for error, own in zip(hypothesis.held, measured, strict=True)
    ]
    return math.sqrt(float(np.median(shares)))


def senseless(hypothesis: Hypothesis, name: str) -> str:
    """Reason why the numbers of the effect ``name`` make no sense, or an empty string."""
    effect = EFFECTS[name]
    own = [b for b in hypothesis.fitted.at_bound if b in effect.fitted and b not in effect.may_vanish]
    if own:
        return f"{', '.join(own)} stopped at a bound"
    return effect.sensible(hypothesis.free_values, hypothesis.fitted.deviations)


def vanished(hypothesis: Hypothesis, name: str) -> bool:
    """Whether what is 0 without the effect ``name`` is smaller than its uncertainty."""
    own = EFFECTS[name].amplitudes
    values, spread = hypothesis.point.values, hypothesis.fitted.deviations
    return bool(own) and all(abs(values[number]) < spread.get(number, 0.0) for number in own)


def trifling(fitting: Fitting, hypothesis: Hypothesis, name: str) -> bool:
    """Whether the effect ``name`` of ``hypothesis`` is too small to mean anything on a machine."""
    return EFFECTS[name].trifling(hypothesis.point.values, span_of(fitting.stretches))


def tolerance(settings: GapSettings, name: str) -> float:
    """Tolerance of gain (relative) or delay (s)."""
    return settings.gain_tolerance if name == GAIN else settings.delay_tolerance
