"""Evidence of one hypothesis over another, on held-out windows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from spool_estimator.identification.least_squares import in_parallel

from spool_gap.fitting.hypothesis import Fitting, Hypothesis
from spool_gap.simulation.point import DELAY, GAIN
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]


def bic_penalty(fitting: Fitting) -> float:
    """BIC penalty of a further number: ln of the samples held out (Schwarz's criterion)."""
    sizes = [window.stop - window.start for _, window, training in fitting.simulation.places if not training]
    return math.log(max(10, sum(sizes)))


def evidence_of(fitting: Fitting, one: Hypothesis, other: Hypothesis) -> float:
    """Evidence for ``other`` over ``one``: gain or delay out of tolerance counts as a number."""
    sensors = {GAIN, DELAY}
    further = len(sensors & set(other.effects)) - len(sensors & set(one.effects))
    return evidence_by_numbers(fitting, one, other, further)


def evidence_by_numbers(fitting: Fitting, one: Hypothesis, other: Hypothesis, further: int = 0) -> float:
    """Evidence for ``other`` over ``one``, which has ``further`` numbers more than are fitted."""
    numbers = len(other.fitted.free) - len(one.fitted.free) + further
    return one.cost - other.cost - bic_penalty(fitting) * numbers


def enough(cost: float) -> float:
    """Evidence that an effect needs over a hypothesis of ``cost``."""
    return max(THRESHOLDS.evidence, THRESHOLDS.relative_gain * cost)


def beats_simpler(fitting: Fitting, simple: Hypothesis, rich: Hypothesis) -> bool:
    """Whether ``rich`` beats ``simple``, which it contains, in the sum and window by window."""
    gain = evidence_by_numbers(fitting, simple, rich)
    return gain > THRESHOLDS.richer_evidence and in_windows(simple.costs - rich.costs, gain / rich.cost)


def in_windows(gains: Array, share: float) -> bool:
    """Wilcoxon's signed-rank test: whether what a richer law gains in each window is more than chance.

    What simulations of friction err by is large in few windows: there a richer law gains by chance. The
    windows are independent, so the sign and rank of each gain decide (Wilcoxon, Biometrics Bulletin 1, 1945).

    Args:
        gains: falls of the weighed sum of squares, one a window, shape (w,).
        share: the fall of all, as a share of the sum that is left; it decides where windows are too few.
    """
    if gains.size < THRESHOLDS.fewest_windows:
        return share > THRESHOLDS.clearly
    return float(stats.wilcoxon(gains, alternative="greater").pvalue) < THRESHOLDS.by_chance


def gain_in_most(one: Hypothesis, other: Hypothesis) -> float:
    """Fall of the cost of ``one`` to ``other`` without the windows in which it is largest."""
    fall = np.sort(one.costs - other.costs)
    return float(fall[: fall.size - math.ceil(THRESHOLDS.most_helped * fall.size)].sum())


def does_as_well(fitting: Fitting, less: Hypothesis, more: Hypothesis) -> bool:
    """Whether ``more`` shows no evidence over ``less``, which lacks one of its effects."""
    gain = evidence_by_numbers(fitting, less, more)
    return gain < THRESHOLDS.evidence or gain < THRESHOLDS.relative_gain * more.cost


def needless(fitting: Fitting, hypothesis: Hypothesis) -> list[str]:
    """Return the first of several effects without which ``hypothesis`` does as well, if there is one."""
    names = hypothesis.effects if len(hypothesis.effects) > 1 else ()
    others = in_parallel(lambda name: fitting.without(hypothesis, [name]), names)
    for name, less in zip(names, others, strict=True):
        no_worse = fitting.nrmse(less) < THRESHOLDS.no_worse * fitting.nrmse(hypothesis)
        if does_as_well(fitting, less, hypothesis) or no_worse:
            return [name]
    return []


def lasting(fitting: Fitting, one: Hypothesis, other: Hypothesis) -> Hypothesis | None:
    """Return ``one`` fitted on from the numbers of ``other`` if that leaves no evidence for ``other``."""
    point = replace(other.point, active=fitting.terms_of(one.effects))
    again = fitting.fit(one.effects, [point], rounds=5, trials=one.trials)
    if again.cost >= one.cost or evidence_by_numbers(fitting, again, other) > enough(again.cost):
        return None
    return again
