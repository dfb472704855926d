"""Sample rate: whether ``sample_period`` agrees with the stamps and the sequence of the blocks."""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from spool_core.block import Block, BlockRun
from spool_core.numbers import Array

#: Relative departure of ``sample_period`` from the stamps that is a fault. A stiffness goes with the square
#: of time: 0.25 % of the period are 0.5 % of the stiffness. Quartz clocks agree to 0.02 % or better.
LIMIT = 2.5e-3
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
#: s of a steady stream after which blocks that do not follow are followed instead, and the longest step.
STRAY, LONGEST_STEP = 1.5, 2.0
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
    _previous: tuple[int, int, int, float] | None = None
    _stray: tuple[int, int, int, float] | None = None
    _stray_since: int = 0
    _direct: bool = False
    _base: int = 0
    _samples: int = 0
    _points: deque[tuple[int, float]] = field(default_factory=deque)
    _low: float = 0.0
    _high: float = 0.0
    _since: int = 0
    _now: int = 0
    _look: int = 0

    @property
    def steady(self) -> bool:
        """Whether stamps without jitter confirm the rate; a block that is due to the nanosecond keeps it."""
        return self.state is RateState.CONFIRMED and self._now - self._since >= CONFIRM * 1e9

    def begin(self, block: Block) -> None:
        """Begin again with the first block of another source or of another period."""
        self.state, self.departure, self.began = RateState.UNKNOWN, math.nan, block.stamp
        self._follow_from(block)

    def go_on(self, block: Block) -> None:
        """Go on with the same source elsewhere: after a loss, with a clock that was set or another rate."""
        if self._previous is not None and block.sample_period == self._previous[3]:
            self._follow_from(block)
        else:
            self.begin(block)

    def take(self, block: Block) -> bool:
        """Take the next block of the stream; return whether it follows the ones before by its sequence."""
        previous = self._previous
        if previous is None:
            self.begin(block)
            return True
        if block.sample_period != previous[3] or not _follows(previous, block):
            # It does not follow: it is taken once its own stream has lasted.
            stray = self._stray
            if stray is None or block.sample_period != stray[3] or not _follows(stray, block):
                self._stray_since = block.stamp
                self._direct = block.sequence == previous[1] + 1
            lasted = block.stamp - self._stray_since >= STRAY * 1e9
            if lasted or (self._direct and self._stray_since != block.stamp):
                if self._direct:
                    self.go_on(block)
                else:
                    self.begin(block)
                return True
            self._stray = (block.stamp, block.sequence, block.body.size, block.sample_period)
            return False
        _, sequence, size, period = previous
        self._stray = None
        self._samples += (block.sequence - sequence) * size
        self._previous = (block.stamp, block.sequence, block.body.size, period)
        self._add(block.stamp - self._base, block.stamp - self._base - self._samples * period * 1e9)
        return True

    def take_steadily(self, run: BlockRun) -> bool:
        """Take a run of a stream that is steady and due to the nanosecond; return whether it was."""
        previous = self._previous
        if previous is None or not self.steady:
            return False
        stamp, sequence, size, period = previous
        due = stamp + size * round(period * 1e9), sequence + 1, period
        if (run.stamp, run.sequence, run.sample_period) != due:
            return False
        count, first = len(run), run.stamp - self._base
        now = range(first, first + count * run.step, run.step)
        samples = range(self._samples + size, self._samples + size + count * run.size, run.size)
        departed = [at - taken * period * 1e9 for at, taken in zip(now, samples, strict=True)]
        low, high = min(self._low, *departed), max(self._high, *departed)
        if high - low > BAND:
            return False
        self._low, self._high, self._stray = low, high, None
        self.state, self.departure = RateState.CONFIRMED, 0.0
        self._samples, self._now = samples[-1], now[-1]
        self._previous = (run.stamp + (count - 1) * run.step, run.sequence + count - 1, run.size, period)
        points, newest = self._points, self._points[-1][0]
        if min(run.step, first - newest) >= SPACING * 1e9:
            points.extend(zip(now, departed, strict=True))
        else:
            for point in zip(now, departed, strict=True):
                if point[0] - newest >= SPACING * 1e9:
                    points.append(point)
                    newest = point[0]
        oldest = self._now - 2e9 * REFUTE
        while points[0][0] < oldest:
            points.popleft()
        return True

    def _follow_from(self, block: Block) -> None:
        self._previous = (block.stamp, block.sequence, block.body.size, block.sample_period)
        self._stray = None
        self._base, self._samples, self._now, self._since, self._look = block.stamp, 0, 0, 0, 0
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


def _follows(previous: tuple[int, int, int, float], block: Block) -> bool:
    """Return whether ``block`` follows by its sequence, and its stamp does not speak against that."""
    stamp, sequence, size, period = previous
    missing, elapsed = block.sequence - sequence - 1, 1e-9 * (block.stamp - stamp)
    duration = size * period
    if missing < 0 or not 0.0 < elapsed <= LONGEST_STEP + LIKELY * duration:
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
    for place, (first, last) in enumerate(pairwise(edges)):
        if last <= first:
            return None
        at, value = time[first : last + 1], departed[first : last + 1]
        at, value = at - at.mean(), value - value.mean()
        spread = float(at @ at)
        slopes[place] = float(at @ value) / spread
        left += float(np.sum((value - slopes[place] * at) ** 2))
        freedom += at.size - 2
        spreads.append(spread)
    deviation = math.sqrt(left / freedom) if freedom > 0 else 0.0
    return slopes, deviation / math.sqrt(min(spreads)), freedom
