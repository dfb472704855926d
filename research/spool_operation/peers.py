"""Peers of the drift test: what each watches, so that its threshold can be set to a false-alarm rate.

Each takes changes of one parameter against its baseline, over the change that has to be found, one a second,
and gives a statistic for each; an alarm is where that exceeds the threshold.

Page, Continuous inspection schemes, Biometrika 41 (1954), and Hinkley (1971) as in river's ``PageHinkley``;
Adams and MacKay, Bayesian online changepoint detection (2007, arXiv:0710.3742), a recursion over lengths of
the present run, whose level is normal around 0 beforehand with standard deviation 1; the gain of the best
split of the last values, which ruptures' ``KernelCPD`` with a linear kernel compares with its penalty; the
level of a local-level Kalman filter in the steady state, fed by its innovations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeAlias, TypeVar

import numpy as np
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_monitor.parameter_drift import ParameterDrift

#: Statistic at each of the values.
Statistic: TypeAlias = Callable[[Array], Array]
Setting = TypeVar("Setting")

#: Values that the best split is looked for in, the shortest part, and values between two looks.
WINDOW, SHORTEST, EVERY = 90, 4, 3
#: Run lengths that are kept.
LENGTHS = 80


@compiled
def page_sum(values: Array, allowance: float) -> Array:
    """Return Page's two-sided sum around 0."""
    found = np.empty(values.size)
    up = down = 0.0
    for i in range(values.size):
        value = min(2.5, max(-2.5, values[i]))
        up = max(0.0, up + value - allowance)
        down = max(0.0, down - value - allowance)
        found[i] = max(up, down)
    return found


@compiled
def page_hinkley(values: Array, delta: float, forgets: float) -> Array:
    """Return the Page-Hinkley statistic of both sides around the running mean."""
    found = np.empty(values.size)
    mean = up = down = lowest = highest = 0.0
    for i in range(values.size):
        mean += (values[i] - mean) / (i + 1)
        up = forgets * up + values[i] - mean - delta
        down = forgets * down + values[i] - mean + delta
        lowest, highest = min(lowest, up), max(highest, down)
        found[i] = max(up - lowest, highest - down)
    return found


@compiled
def kalman_level(values: Array, share: float) -> Array:
    """Return the size of the level that the filter follows with gain ``share``."""
    found = np.empty(values.size)
    level = 0.0
    for i in range(values.size):
        level += share * (values[i] - level)
        found[i] = abs(level)
    return found


@compiled
def innovations(values: Array, share: float, allowance: float) -> Array:
    """Return Page's sum of the innovations of a filter that follows with gain ``share``."""
    found = np.empty(values.size)
    level = up = down = 0.0
    for i in range(values.size):
        innovation = values[i] - level
        level += share * innovation
        up = max(0.0, up + innovation - allowance)
        down = max(0.0, down - innovation - allowance)
        found[i] = max(up, down)
    return found


@compiled
def best_split(values: Array) -> Array:
    """Return the gain of the best split of the last ``WINDOW`` values, looked for at every ``EVERY``."""
    found = np.zeros(values.size)
    sums = np.zeros(values.size + 1)
    for i in range(values.size):
        sums[i + 1] = sums[i] + values[i]
    for i in range(2 * SHORTEST, values.size + 1):
        found[i - 1] = found[i - 2]
        if i % EVERY:
            continue
        first = max(0, i - WINDOW)
        count, total = i - first, sums[i] - sums[first]
        best = 0.0
        for j in range(first + SHORTEST, i - SHORTEST + 1):
            left, part = j - first, sums[j] - sums[first]
            right, rest = count - left, total - part
            best = max(best, part * part / left + rest * rest / right - total * total / count)
        found[i - 1] = best
    return found


@compiled
def run_level(values: Array, hazard: float, scatter: float) -> Array:
    """Return the size of the posterior mean level of the present run; run lengths up to ``LENGTHS``."""
    found = np.empty(values.size)
    noise, prior = scatter**-2, 1.0
    weights, sums = np.zeros(LENGTHS + 1), np.zeros(LENGTHS + 1)
    weights[0] = 1.0
    used = 1
    joint = np.zeros(LENGTHS + 1)
    for i in range(values.size):
        highest = -1e300
        for r in range(used):
            precision = prior + noise * r
            variance = 1.0 / precision + 1.0 / noise
            off = values[i] - noise * sums[r] / precision
            joint[r] = -0.5 * (off * off / variance + np.log(variance)) + np.log(weights[r] + 1e-300)
            highest = max(highest, joint[r])
        total = 0.0
        for r in range(used):
            joint[r] = np.exp(joint[r] - highest)
            total += joint[r]
        grown = min(used + 1, LENGTHS + 1)
        # What is longer than the longest kept joins it, with its own sum scaled to that length.
        last = joint[used - 1]
        for r in range(grown - 1, 0, -1):
            weights[r] = (1.0 - hazard) * joint[r - 1] / total
            sums[r] = sums[r - 1] + values[i]
        if used == LENGTHS + 1:
            weights[LENGTHS] += (1.0 - hazard) * last / total
        weights[0], sums[0] = hazard, 0.0
        used = grown
        level = 0.0
        for r in range(used):
            level += weights[r] * noise * sums[r] / (prior + noise * r)
        found[i] = abs(level)
    return found


#: By detector, its settings by name; of each the threshold is set to the rate of false alarms.
PEERS: dict[str, dict[str, Statistic]] = {
    "CUSUM": {
        f"allowance {one:g}": partial(page_sum, allowance=one) for one in (0.05, 0.1, 0.2, 0.3, 0.45, 0.65)
    },
    "Page-Hinkley": {
        f"delta {one:g}, alpha {forgets:g}": partial(page_hinkley, delta=one, forgets=forgets)
        for one in (0.05, 0.2, 0.5)
        for forgets in (1.0, 0.99)
    },
    "Kalman level": {f"gain {one:g}": partial(kalman_level, share=one) for one in (0.03, 0.1, 0.3, 0.8)},
    "Kalman innovations": {
        f"gain {one:g}, allowance {allowance:g}": partial(innovations, share=one, allowance=allowance)
        for one in (0.003, 0.03)
        for allowance in (0.05, 0.2)
    },
    "ruptures KernelCPD": {f"window {WINDOW}": best_split},
    "Bayesian change points": {
        f"hazard {hazard:g}, scatter {scatter:g}": partial(run_level, hazard=hazard, scatter=scatter)
        for hazard, scatter in ((1e-3, 0.05), (1e-5, 0.2))
    },
}


def judged_share(test: ParameterDrift) -> float:
    """Return the last change over the one that matters, which the peers see; NaN where it was not judged."""
    size = test.matters * (abs(test.baseline.value) if test.relative else 1.0)
    judged = test.judged and test.baseline.frozen
    return (test.quantity.value - test.baseline.value) / size if judged else math.nan


def first_alarm(statistic: Array, threshold: float, at: Array) -> float:
    """Return at which of the times ``at`` (s) ``statistic`` first exceeds ``threshold``; else infinite."""
    above = np.flatnonzero(statistic > threshold)
    return float(at[above[0]]) if above.size else math.inf


def soonest(delays: Mapping[Setting, Array]) -> tuple[Setting, Array]:
    """Return the setting that misses least and then is soonest, and its delays, s; not finite: missed."""
    return min(delays.items(), key=lambda one: (int((~np.isfinite(one[1])).sum()), median(one[1])))


def median(delays: Array) -> float:
    """Return the median of the delays that are finite, infinite where none is."""
    found = delays[np.isfinite(delays)]
    return float(np.median(found)) if found.size else math.inf
