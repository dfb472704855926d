"""Levels of a healthy valve's parameter, and how far its weeks lie around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import Z_95

from spool_fleet.trends.change_test import LEAST_WEEKS
from spool_fleet.trends.weekly import spread

from .trend_rows import TrendRow

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Level:
    """Level around which a parameter stays from day ``first`` to ``last``, relative to the baseline.

    95 % of the weeks in which nothing changed lie within ``half_width`` of it; NaN: there are too few.
    """

    first: float
    last: float
    value: float
    half_width: float


def levels_of(
    day: Array, value: Array, segment: NDArray[np.int64], trend: TrendRow, turns: Sequence[float]
) -> tuple[Level, ...]:
    """Return the baseline until the first service, and the usual value after each until a change begins.

    The table of trends holds the first baseline alone, so a later one is the median of its weeks.

    Args:
        day, value, segment: of each week, shape (n,); segments are the services before it.
        trend: of the parameter.
        turns: days of the services that may have stepped it.
    """
    if not day.size:
        return ()
    first, last = float(day[0]), float(day[-1])
    if not trend.baseline > 0.0:
        return (Level(first, last, 1.0, math.nan),)
    healthy = day < trend.since if trend.changed else np.ones(day.size, dtype=bool)
    begins, ends = [first, *turns], [*turns, last]
    found, around = [], [np.empty(0)]
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        own = value[healthy & (segment == number)]
        if own.size:
            around.append(own / np.median(own))
        if own.size or (number == 0 and begin < end):
            found.append((begin, end, float(np.median(own)) if number else 1.0))
    rows = np.concatenate(around)
    half = Z_95 * spread(rows) if rows.size >= LEAST_WEEKS else math.nan
    return tuple(Level(begin, end, middle, half * middle) for begin, end, middle in found)
