"""Sample rate: whether ``sample_period`` agrees with the stamps and the sequence of the blocks."""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from spool_core.numbers import Array
from spool_core.one_source import STALE, Place, Rival
from spool_core.stamps import LEAST_CERTAIN, line_through

#: Relative departure of ``sample_period`` from the stamps that is a fault. Quartz clocks agree to 0.02 %.
LIMIT = LEAST_CERTAIN
#: s of stamps that confirm a rate, and that say that it is wrong: before a first estimate has parameters.
CONFIRM, REFUTE = 1.5, 1.8
#: ns, stamps that stay this near to the claimed ones over CONFIRM confirm a rate: half the limit.
BAND = 0.5 * LIMIT * CONFIRM * 1e9
#: Standard errors that a departure must exceed the limit by: one false alarm in 30,000 looks, were they
#: independent, and three segments must agree on top.
CERTAIN = 4.0
#: Times REFUTE of stamps that are looked back on, one after the other while jitter hides the rate.
SPANS = (1.0, 2.0, 4.0, 8.0, 16.0)
#: s of stamps between two points, and between two looks.
SPACING, LOOK = 0.02, 0.1
#: Standard deviation of the median of three slopes over that of one, for normal numbers, and that of the
#: slope over all three segments: it goes with the length to the power of -3/2.
MEDIAN, WHOLE = 0.67, 0.19
#: Points beyond the two of each straight line from which its error is known, and share of a slope that three
#: slopes may differ by where it is not: jitter makes three so equal once in a million looks.
ENOUGH, EQUAL = 6, 1.0e-3
#: s, the longest step of the stamps.
LONGEST_STEP = 2.0
#: Times by which a loss may differ from what the stamps say elapsed.
LIKELY = 3.0


class RateState(enum.Enum):
    """State of the rate check: what is known of the sample rate."""

    UNKNOWN = "unknown"  # not enough stamps yet
    CONFIRMED = "confirmed"  # sample_period agrees with the stamps
    DOUBTFUL = "doubtful"  # it did; the newest stamps do not agree
    WRONG = "wrong"  # it does not


@dataclass(slots=True)
class RateCheck:
    """Compares what the samples of a stream should have taken with what the stamps say they took.

    A jump of the stamps is no rate: three segments in a row must agree, and jitter is averaged by least
    squares within each. Lost blocks count as long as the ones before them.

    Attributes:
        state: what is known now.
        departure: ``sample_period`` over the period that the stamps show, less 1; NaN where not measured.
        began: stamp (ns) of the first block of this source and period.

    """

    state: RateState = RateState.UNKNOWN
    departure: float = math.nan
    began: int = 0
    _last: Place | None = None
    _stray: Rival | None = None
    _base: int = 0
    _claimed: int = 0
    _points: deque[tuple[int, float]] = field(default_factory=deque)
    _low: float = 0.0
    _high: float = 0.0
    _since: int = 0
    _now: int = 0
    _look: int = 0

    def begin(self, block: Place) -> None:
        """Begin again with the first block of another source or of another period."""
        self.state, self.departure, self.began = RateState.UNKNOWN, math.nan, block.stamp
        self._follow_from(block)

    def go_on(self, block: Place) -> None:
        """Go on with the same source elsewhere: after a loss, with a clock that was set or another rate."""
        if self._last is not None and block.period == self._last.period:
            self._follow_from(block)
        else:
            self.begin(block)

    def take(self, block: Place) -> bool:
        """Take the next block of the stream; return whether it follows the ones before by its sequence."""
        last = self._last
        if last is None:
            self.begin(block)
            return True
        if not _follows(last, block):
            stray = self._stray
            if stray is None or not _follows(stray.place, block):
                direct = block.sequence == last.sequence + 1
                self._stray = Rival(block, block.stamp, 1, direct)
                return False
            # It is taken once its own stream has lasted.
            stray.place = block
            if stray.direct:
                self.go_on(block)
            elif block.stamp - stray.since >= STALE * 1e9:
                self.begin(block)
            return self._last is block
        self._stray, self._last = None, block
        self._claimed += (block.sequence - last.sequence) * (last.end - last.stamp)
        now = block.stamp - self._base
        self._add(now, float(now - self._claimed))
        return True

    def _follow_from(self, block: Place) -> None:
        self._last, self._stray = block, None
        self._base, self._claimed, self._now, self._since, self._look = block.stamp, 0, 0, 0, 0
        self._low = self._high = 0.0
        self._points.clear()
        self._points.append((0, 0.0))

    def _add(self, now: int, departed: float) -> None:
        """Take a point: ns since the first stamp, and by how many of them the stamp is ahead."""
        self._now = now
        if now - self._points[-1][0] >= SPACING * 1e9:
            self._points.append((now, departed))
        low, high = min(self._low, departed), max(self._high, departed)
        if high - low <= BAND:
            self._low, self._high = low, high
            if now - self._since >= CONFIRM * 1e9:
                self.state, self.departure = RateState.CONFIRMED, 0.0
                oldest = now - 2e9 * REFUTE
                while self._points[0][0] < oldest:
                    self._points.popleft()
                return
        else:
            self._low = self._high = departed
            self._since = now
        if now - self._look >= LOOK * 1e9:
            self._look = now
            self._judge()

    def _judge(self) -> None:
        oldest = self._now - round(max(SPANS) * REFUTE * 1e9)
        while len(self._points) > 2 and self._points[1][0] <= oldest:
            self._points.popleft()
        for span in SPANS:
            begin = self._now - span * REFUTE * 1e9
            if self._points[0][0] > begin:
                return
            first = begin - SPACING * 1e9
            found = _slopes(np.array([point for point in self._points if point[0] >= first]))
            if found is None:
                continue
            slopes, error, freedom = found
            middle, apart = float(np.median(slopes)), float(np.std(slopes, ddof=1))
            if freedom < ENOUGH:
                # Blocks so long that jitter does not show: only slopes that are equal prove anything.
                wrong = abs(middle) > LIMIT and apart < EQUAL * abs(middle)
                right = float(np.abs(slopes).max()) <= LIMIT
            else:
                wrong = abs(middle) > LIMIT + CERTAIN * MEDIAN * max(error, apart)
                right = abs(float(np.mean(slopes))) + CERTAIN * WHOLE * error <= 2.0 * LIMIT
            if wrong:
                self.state, self.departure = RateState.WRONG, -middle
                return
            if right:
                doubtful = abs(slopes[-1]) > LIMIT + CERTAIN * error and self.state is not RateState.UNKNOWN
                self.state = RateState.DOUBTFUL if doubtful else RateState.CONFIRMED
                self.departure = -middle
                return


def _follows(last: Place, block: Place) -> bool:
    """Return whether ``block`` follows by its sequence, and its stamp does not speak against that."""
    missing, elapsed = block.sequence - last.sequence - 1, 1e-9 * (block.stamp - last.stamp)
    duration = 1e-9 * (last.end - last.stamp)
    if missing < 0 or block.period != last.period or not 0.0 < elapsed <= LONGEST_STEP + LIKELY * duration:
        return False
    claimed = (missing + 1) * duration
    return missing == 0 or elapsed / LIKELY <= claimed <= LIKELY * elapsed


def _slopes(points: Array) -> tuple[Array, float, int] | None:
    """Return by how much stamps run ahead, per s of stamps, in three segments, and the error of one of them.

    And how many degrees of freedom that error has. ``points`` has shape (n, 2); ``None`` where there are too
    few.
    """
    time, departed = points[:, 0], points[:, 1]
    edges = np.searchsorted(time, time[0] + (time[-1] - time[0]) * np.array([0.0, 1.0, 2.0, 3.0]) / 3.0)
    slopes, left, freedom, spreads = np.empty(3), 0.0, 0, []
    for place in range(3):
        first, last = edges[place], edges[place + 1]
        if last <= first:
            return None
        at, value = time[first : last + 1], departed[first : last + 1]
        slopes[place], level = line_through(at, value)
        left += float(np.sum((value - level - slopes[place] * at) ** 2))
        freedom += at.size - 2
        spreads.append(at.size * float(at.var()))
    deviation = math.sqrt(left / freedom) if freedom > 0 else 0.0
    return slopes, deviation / math.sqrt(min(spreads)), freedom
