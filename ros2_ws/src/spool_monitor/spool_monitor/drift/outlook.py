"""Outlook of a drift: whether it goes on steadily, and when it reaches the limit of an alarm then.

ISA-18.2 (IEC 62682) wants an alarm's priority from what happens and how much time there is. A straight line
through the change since its beginning tells the time where the second half of it rises as the first one does;
a step, and what has come to rest, tell none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.text import duration

Array = NDArray[np.float64]

#: Points that are kept; where there are more, every other one goes.
MOST = 128
#: Points, and memories of the estimator, from which a trend can be seen: what forgets shows a step as a rise.
LEAST, MEMORIES = 8, 4.0
#: Standard deviations that a slope must exceed, and its share in each half of the time, both ways.
SIGNIFICANT, STEADY = 3.0, 0.5
#: s, the longest time to a limit that is said: a trend of minutes says nothing of months.
LONGEST = 30.0 * 86400.0


@dataclass(slots=True)
class Outlook:
    """Outlook of one parameter: its changes since the sum of the sequential test left zero."""

    _since: int = field(default=0, init=False)
    _points: list[tuple[float, float]] = field(default_factory=list, init=False)
    _every: int = field(default=1, init=False)
    _count: int = field(default=0, init=False)

    def reset(self) -> None:
        """Forget what went before."""
        self._points.clear()
        self._every, self._count = 1, 0

    def take(self, since: int, stamp: int, change: float) -> None:
        """Take the ``change`` at ``stamp`` (ns) of a drift that began at ``since`` (ns, 0: there is none)."""
        if since != self._since or since == 0:
            self.reset()
            self._since = since
        if since == 0:
            return
        self._count += 1
        if self._count % self._every == 0:
            self._points.append(((stamp - since) * 1e-9, change))
        if len(self._points) > MOST:
            self._points = self._points[::2]
            self._every *= 2

    def seconds_to(self, limit: float, memory: float) -> float:
        """Return the time, s, until the change reaches ``limit`` of its own sign; NaN where no trend tells.

        Args:
            limit: size of the change, > 0, in the unit of the changes taken.
            memory: s, over which the estimates forget.
        """
        if len(self._points) < LEAST:
            return math.nan
        time, change = np.array(self._points).T
        length = float(time[-1] - time[0])
        if length < MEMORIES * memory:
            return math.nan
        slope, deviation = _slope(time, change, memory)
        half = time.size // 2
        first, second = (
            _slope(time[part], change[part], memory)[0] for part in (slice(half), slice(half, None))
        )
        steady = all(STEADY <= part / slope <= 1.0 / STEADY for part in (first, second)) if slope else False
        now = float(np.mean(change[-max(1, time.size // 8) :]))
        if not steady or abs(slope) < SIGNIFICANT * deviation or slope * now <= 0.0:
            return math.nan
        return max(0.0, (limit - abs(now)) / abs(slope))

    def text(self, limit: float, memory: float) -> str:
        """Return when the limit of an alarm is reached, in words, or that no trend tells it."""
        seconds = self.seconds_to(limit, memory)
        if math.isnan(seconds) or seconds > LONGEST:
            return "no steady trend, so nothing is said of when the limit of an alarm is reached"
        return f"at the present rate the limit of an alarm is reached in about {duration(seconds)}"


def _slope(time: Array, change: Array, memory: float) -> tuple[float, float]:
    """Return the slope of ``change`` over ``time`` (s) and its standard deviation.

    Neighbours that share the estimator's memory count as one.
    """
    around = time - time.mean()
    spread = float(around @ around)
    if time.size < 3 or spread <= 0.0:
        return 0.0, math.inf
    slope = float(around @ change) / spread
    left = change - change.mean() - slope * around
    worth = max(3.0, min(float(time.size), (float(time[-1] - time[0])) / max(2.0 * memory, 1e-9)))
    variance = float(left @ left) / time.size * worth / (worth - 2.0)
    return slope, math.sqrt(variance / (spread * worth / time.size))
