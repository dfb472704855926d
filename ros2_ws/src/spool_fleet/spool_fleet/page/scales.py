"""Scales of the fleet's charts: the same for every valve, so that an odd one stands out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone

import numpy as np

from spool_fleet.trends.observations import DAY

#: Limits of the monitor that a chart shows on either side at least, and at most: what goes further is drawn
#: at the edge, else one broken estimate would make lines of all others.
LEAST_SEEN, MOST_SEEN = 1.2, 3.0
#: Share of the baseline beyond which a limit is not shown (dry friction near zero has limits of many times
#: its value), and share up to which is shown at least what there is.
FAR_LIMIT, NEAR = 0.5, 1.0
#: Marks on an axis at most.
MOST_TICKS, MOST_DATES = 5, 5


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale from ``low`` to ``high`` with marks."""

    low: float
    high: float
    ticks: tuple[float, ...]

    def share(self, value: float) -> float:
        """Return where ``value`` lies: 0 at the low end, 1 at the high one."""
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True, slots=True)
class TimeScale:
    """Scale of days since 1970; ``ticks`` are the days and names of months."""

    first: float
    last: float
    ticks: tuple[tuple[float, str], ...]

    def share(self, day: float) -> float:
        """Return where ``day`` lies: 0 at the begin, 1 at the end."""
        return (day - self.first) / (self.last - self.first)


def relative_scale(largest: Sequence[float], limits: Sequence[float]) -> Scale:
    """Return the scale of relative values (1: baseline) of one parameter over all valves.

    Args:
        largest: difference from the baseline in each valve.
        limits: of the monitor in each valve.
    """
    known = [one for one in limits if math.isfinite(one)]
    limit = min(float(np.median(known)), FAR_LIMIT) if known else FAR_LIMIT
    reach = min(max(1.05 * max(largest, default=0.0), LEAST_SEEN * limit), max(MOST_SEEN * limit, NEAR))
    low, high = max(0.0, 1.0 - reach), 1.0 + reach
    return Scale(low, high, tuple(1.0 + one for one in ticks(low - 1.0, high - 1.0)))


def plain_scale(values: Sequence[float]) -> Scale:
    """Return a scale around ``values``."""
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    margin = max(0.05 * (high - low), 1.0)
    return Scale(low - margin, high + margin, ticks(low - margin, high + margin))


def time_scale(first: float, last: float) -> TimeScale:
    """Return the scale of the days from ``first`` to ``last``, at least two weeks, with months marked."""
    margin = max(0.02 * (last - first), 7.0 - 0.5 * (last - first), 1.0)
    first, last = first - margin, last + margin
    begin = datetime.fromtimestamp(first * DAY, timezone.utc)
    months = 12 * begin.year + begin.month  # the month after the first day's
    found = []
    while (day := _first_of(months)) <= last:
        found.append((day, months))
        months += 1
    steps = (1, 2, 3, 6, 12, 24, 60, 120, 1200)
    step = next((one for one in steps if len(found) <= MOST_DATES * one), 12000)
    named = [(day, f"{number // 12}-{number % 12 + 1:02d}") for day, number in found if number % step == 0]
    if not named:
        named = [(0.5 * (first + last), (begin + timedelta(days=margin)).strftime("%Y-%m-%d"))]
    return TimeScale(first, last, tuple(named))


def ticks(low: float, high: float, most: int = MOST_TICKS) -> tuple[float, ...]:
    """Return round numbers between ``low`` and ``high``, ``most`` at most."""
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0):
        step = factor * power
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first < most:
            break
    return tuple(number * step for number in range(first, last + 1))


def _first_of(months: int) -> float:
    """Return the day on which a month begins, counted from the year 0."""
    return datetime(months // 12, months % 12 + 1, 1, tzinfo=timezone.utc).timestamp() / DAY
