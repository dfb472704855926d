"""Sister valves: what all valves of a fleet do together, and how much a healthy one scatters.

Each number is a median over the valves, so that some that wear do not move it; what a valve has too few data
for comes from its sisters (partial pooling, as in Gelman and Hill 2007, chapter 12).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from .weekly import Weekly, mean_square, spread

Array = NDArray[np.float64]

#: Sisters from which their median is a course to compare with.
LEAST_SISTERS = 4
#: Weeks over which slow wandering is told from the noise of neighbouring weeks, at least.
LAG = 8
#: 1/K: slope of the logarithm where values are referred to one temperature (the monitor's error of an oil's
#: law) and where they are not (an ISO VG 68 oil around 45 deg C, ASTM D341), each with its spread.
REFERRED_SLOPE, RAW_SLOPE = (0.0, 0.002), (-0.04, 0.015)
#: Differences that a variance needs, and the relative variance of a mean square of n of them, times n (von
#: Neumann 1941: neighbours share a value).
LEAST_DIFFERENCES, SAMPLING = 3, 3.0
#: Degrees of freedom from which the scatter within weeks tells more than that between them.
WITHIN = 10.0


@dataclass(frozen=True, slots=True)
class Scatter:
    """Scatter of the healthy valves of a fleet in one parameter, in the logarithm.

    Attributes:
        noise: variance of a week's value.
        noise_spread: variance of the logarithm of that between valves.
        between: variance of a week's value beyond what the scatter of its bags explains.
        wander: variance that a week adds to the level (random walk).
        slope_spread: of the slopes on the oil temperature between valves, 1/K.
    """

    noise: float = 0.0
    noise_spread: float = math.inf
    between: float = 0.0
    wander: float = 0.0
    slope_spread: float = 0.0


def pooled_slope(valves: Sequence[Weekly], referred: bool) -> tuple[float, float]:
    """Return slope on the oil temperature, 1/K, and its spread between valves; physics where few show it."""
    found = np.array([slope for slope in map(own_slope, valves) if math.isfinite(slope)])
    expected, width = REFERRED_SLOPE if referred else RAW_SLOPE
    if found.size < LEAST_SISTERS:
        return expected, width
    return float(np.median(found)), min(width, spread(found))


def scatter_of(valves: Sequence[Weekly], slope_spread: float = 0.0) -> Scatter:
    """Return the scatter of ``valves``, whose slopes on the oil temperature differ by ``slope_spread``.

    It is that of the values: what their bags state of their uncertainty holds a part that all share.
    """
    noises, counts, betweens, wanders = [], [], [], []
    for valve in valves:
        # A slope of its own is no wandering.
        flat = _flattened(valve, own_slope(valve) if slope_spread > 0.0 else 0.0)
        near, step = differences(valve, flat, 0)
        far, leap = differences(valve, flat, LAG)
        if near.size < LEAST_DIFFERENCES:
            continue
        noises.append(0.5 * mean_square(near))
        counts.append(near.size)
        if valve.freedom >= WITHIN:
            betweens.append(noises[-1] - float(np.mean(valve.bag_variance / valve.count)))
        if far.size >= LEAST_DIFFERENCES and leap > step:
            wanders.append((mean_square(far) - mean_square(near)) / (leap - step))
    if not noises:
        return Scatter(slope_spread=slope_spread)
    logarithms = np.log(np.maximum(noises, 1e-300))
    sampling = float(np.mean(SAMPLING / np.array(counts)))
    alike = len(noises) >= LEAST_SISTERS
    return Scatter(
        float(np.median(noises)),
        max(0.0, spread(logarithms) ** 2 - sampling) if alike else math.inf,
        max(0.0, float(np.median(betweens))) if betweens else 0.0,
        max(0.0, float(np.median(wanders))) if wanders else 0.0,
        slope_spread,
    )


def own_noise(valve: Weekly, scatter: Scatter) -> tuple[Array, float]:
    """Return the variance of each week's value of ``valve``, shape (n,), and its degrees of freedom."""
    near, _ = differences(valve, valve.value, 0)
    own = 0.5 * mean_square(near) if near.size >= LEAST_DIFFERENCES else 0.0
    sampling = SAMPLING / max(1, near.size)
    if valve.freedom >= WITHIN:
        noise = valve.bag_variance / valve.count + scatter.between
        # Its weeks may differ by more than its sisters' do.
        surely = own * max(0.0, 1.0 - 2.0 * math.sqrt(sampling))
        return noise * max(1.0, surely / float(np.mean(noise))), valve.freedom
    if near.size < LEAST_DIFFERENCES or scatter.noise <= 0.0:
        return np.full(valve.value.size, scatter.noise), 1.0
    weight = 1.0
    if math.isfinite(scatter.noise_spread):
        weight = scatter.noise_spread / (scatter.noise_spread + sampling)
    logarithm = weight * math.log(max(own, 1e-300)) + (1.0 - weight) * math.log(scatter.noise)
    return np.full(valve.value.size, math.exp(logarithm)), 2.0 / max(weight * sampling, 1e-3)


def common_course(valves: Sequence[Weekly], least: int = LEAST_SISTERS) -> dict[int, float]:
    """Return the course that ``valves`` share, by week.

    It is the median of their values, each less its own level since its last service; weeks with fewer than
    ``least`` valves have none.
    """
    courses: dict[int, list[float]] = {}
    for valve in valves:
        for segment in np.unique(valve.segment):
            own = valve.segment == segment
            around = valve.value[own] - np.median(valve.value[own])
            for week, value in zip(valve.week[own].tolist(), around.tolist(), strict=True):
                courses.setdefault(week, []).append(value)
    return {week: median(values) for week, values in courses.items() if len(values) >= least}


def _flattened(valve: Weekly, slope: float) -> Array:
    """Return the values without what the oil temperature does by ``slope``."""
    known = np.isfinite(valve.temperature)
    if not known.any() or not math.isfinite(slope):
        return valve.value
    return np.asarray(
        valve.value - slope * np.where(known, valve.temperature - np.median(valve.temperature[known]), 0.0)
    )


def own_slope(valve: Weekly) -> float:
    """Return Theil and Sen's slope of the value on the temperature, 1/K; NaN where that hardly changes."""
    known = np.isfinite(valve.temperature)
    value, warm, segment = valve.value[known], valve.temperature[known], valve.segment[known]
    if value.size < 8 or np.ptp(warm) < 5.0:
        return math.nan
    first, second = np.triu_indices(value.size, 1)
    apart = (np.abs(warm[second] - warm[first]) > 0.2 * np.ptp(warm)) & (segment[second] == segment[first])
    if not apart.any():
        return math.nan
    rise = (value[second] - value[first])[apart] / (warm[second] - warm[first])[apart]
    return float(np.median(rise))


def differences(valve: Weekly, flat: Array, lag: int) -> tuple[Array, float]:
    """Return the differences of values with those at least ``lag`` weeks later, and how far apart they lie.

    Without a lag they are those of neighbours; none reaches over a service.
    """
    later = np.maximum(np.searchsorted(valve.week, valve.week + lag), np.arange(valve.week.size) + 1)
    first = np.flatnonzero(later < valve.week.size)
    first = first[valve.segment[later[first]] == valve.segment[first]]
    if first.size == 0:
        return np.empty(0), 1.0
    second = later[first]
    return flat[second] - flat[first], float(np.median(valve.week[second] - valve.week[first]))
