"""What a stored trend promises: how often a parameter came near its limit, and when it will reach it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from spool_core.numbers import Array

from spool_monitor.trend import DAY, HOUR, Span, TrendStore

#: Variances of the random steps of level and slope, in variances of a value's noise, that are averaged over.
LEVELS, SLOPES = np.geomspace(1e-3, 3.0, 8), np.geomspace(1e-6, 1e-1, 11)
#: Values that a statement needs at least, and the newest ones that are used at most.
LEAST, MOST = 14, 120
#: Courses of the future that are drawn (4000 tell 5 % to 0.3 %), and how far, in lengths of the past.
COURSES, AHEAD = 4000, 4
#: Probability of a course towards the limit below which nothing is stated; ends of the interval.
SURE, ENDS = 0.95, (0.05, 0.95)
#: Share of the way from the healthy value to the limit that counts as near it.
NEAR = 0.8


@dataclass(frozen=True, slots=True)
class TimeToLimit:
    """Time to the limit from the end of the last span, s: 90 % interval; ``late`` may be infinite."""

    early: float
    late: float


def near_days(spans: Sequence[Span], healthy: float, limit: float) -> int:
    """Return on how many days (UTC) a mean of ``spans`` came :data:`NEAR` of the way to ``limit`` or more."""
    way = limit - healthy
    return len({span.start // DAY for span in spans if way and (span.mean - healthy) / way >= NEAR})


def time_to_limit(spans: Sequence[Span], seconds: int, limit: float) -> TimeToLimit | None:
    """Return when the mean of a parameter will reach ``limit``; ``None`` where its trend does not tell.

    The means are a level whose slope wanders, with noise (local linear trend; Harvey 1989, section 2.3.2),
    filtered for each pair of :data:`LEVELS` and :data:`SLOPES` and weighted by their likelihoods. Courses of
    the future are drawn from that. Their slopes keep their sign: wear does not heal.

    Args:
        spans: of the parameter, oldest first; some may be missing.
        seconds: length of one.
        limit: in the unit of the parameter.
    """
    used = spans[-MOST:]
    if len(used) < LEAST or len({span.mean for span in used}) == 1:
        return None
    gaps = [(after.start - before.start) // seconds for before, after in pairwise(used)]
    found = _filtered(np.array([span.mean for span in used]), gaps)
    random = np.random.default_rng(0)
    drawn = random.choice(found.weights.size, COURSES, p=found.weights)
    scale = np.sqrt(found.squares[drawn] / random.chisquare(len(used) - 2, COURSES))
    root = found.covariance[:, drawn]
    level_step, slope_step = (scale * np.sqrt(one[drawn]) for one in _pairs())
    first, second = random.standard_normal((2, COURSES))
    level = found.level[drawn] + scale * np.sqrt(root[0]) * first
    rest = np.maximum(root[2] - root[1] ** 2 / root[0], 0.0)
    slope = found.slope[drawn] + scale * (root[1] / np.sqrt(root[0]) * first + np.sqrt(rest) * second)
    side = np.sign(limit - found.weights @ found.level)
    if np.mean(slope * side > 0.0) < SURE:
        return None
    slope = np.abs(slope) * side
    reached = np.full(COURSES, np.inf)
    for step in range(1, AHEAD * sum(gaps) + 1):
        level += slope + level_step * random.standard_normal(COURSES)
        slope = np.abs(slope + slope_step * random.standard_normal(COURSES)) * side
        reached[(level - limit) * side >= 0.0] = np.minimum(reached[(level - limit) * side >= 0.0], step)
    early, late = np.quantile(reached, ENDS, method="nearest") * seconds
    return TimeToLimit(float(early), float(late)) if np.isfinite(early) else None


def outlook(
    store: TrendStore, name: str, healthy: float | None, limits: Sequence[float | None], now: int
) -> tuple[int, TimeToLimit | None]:
    """Return on how many of the last 7 days the parameter ``name`` was near a limit, and when it reaches one.

    By days where enough are kept, else by hours; the span of ``now`` (s since 1970) is not over yet. Drag is
    taken as referred to one temperature of the oil where that is kept.

    Raises:
        InputError, OSError: as of :meth:`~spool_monitor.trend.TrendStore.spans`.
    """
    if healthy is None:
        return 0, None
    referred = f"referred_{name}"
    series = referred if referred in store.units() else name
    past = {
        seconds: [one for one in store.spans(series, seconds, now - reach) if one.start + seconds <= now]
        for seconds, reach in ((HOUR, 7 * DAY), (DAY, 366 * DAY))
    }
    seconds = DAY if len(past[DAY]) >= LEAST else HOUR
    near, times = 0, []
    for limit in limits:
        if limit is not None and past[seconds]:
            near += near_days(past[HOUR], healthy, limit)
            if (past[seconds][-1].mean - limit) * (healthy - limit) > 0.0:
                times.append(time_to_limit(past[seconds], seconds, limit))
    return near, next((one for one in times if one is not None), None)


@dataclass(frozen=True, slots=True)
class _Filtered:
    """State after the last value for each pair of variances, shapes (m,); ``covariance`` (3, m), relative."""

    level: Array
    slope: Array
    covariance: Array
    squares: Array
    weights: Array


def _pairs() -> Array:
    return np.stack((np.repeat(LEVELS, SLOPES.size), np.tile(SLOPES, LEVELS.size)))


def _filtered(values: Array, gaps: Sequence[int]) -> _Filtered:
    """Filter ``values`` (n,), ``gaps`` (n-1) steps apart, from the first one and an unknown slope."""
    pairs = _pairs()
    level: Array
    slope: Array
    own: Array
    both: Array
    other: Array
    level, slope = np.full(pairs.shape[1], values[0]), np.zeros(pairs.shape[1])
    own, both, other = np.ones_like(slope), np.zeros_like(slope), np.full_like(slope, 1e6)
    squares, determinant = np.zeros_like(slope), np.zeros_like(slope)
    for number, (gap, value) in enumerate(zip(gaps, values[1:], strict=True)):
        for _ in range(gap):
            level = level + slope
            own, both, other = own + 2.0 * both + other + pairs[0], both + other, other + pairs[1]
        spread, error = own + 1.0, value - level
        if number:  # the second value only tells the slope
            squares, determinant = squares + error**2 / spread, determinant + np.log(spread)
        gain = own / spread, both / spread
        level, slope = level + gain[0] * error, slope + gain[1] * error
        own, both, other = own - gain[0] * own, both - gain[0] * both, other - gain[1] * both
    likelihood = -0.5 * determinant - 0.5 * (values.size - 2) * np.log(squares)
    weights = np.exp(likelihood - likelihood.max())
    return _Filtered(level, slope, np.stack((own, both, other)), squares, weights / weights.sum())
