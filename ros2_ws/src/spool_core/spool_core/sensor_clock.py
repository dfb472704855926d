"""Clock of a sensor: the sample period behind its stamps, and steps of the clock.

Two things are observed of each sample: by how much its stamp is off the clock's line (the residual), and by
how much it is ahead of the other sensor's newest stamp when it arrives (the lag). A loss moves the residual
and leaves the lag; a clock that was set moves both by the same amount; drift moves both slowly.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from spool_core.numbers import MEDIAN_TO_DEVIATION, Array
from spool_core.stamps import Indices, line_through, on_line

#: s of stamps that the phase and the rate are averaged over once there are so many. Stamps that jitter by J
#: leave the phase 2 J / sqrt(samples in it) (standard error of a line's end), 10 us of 0.5 ms at 1 kHz, and
#: quartz clocks that warm up change their rate by less than 1e-6 meanwhile.
MEMORY = 10.0

#: Samples over which the size of the jitter is averaged, and how many times its size a stamp counts with.
JITTER_SAMPLES, JITTER_CLIP = 500, 5.0

#: Share of changes that a large one exceeds, and standard deviations in it: 1 / 1.645 for normal errors.
LARGE, LARGE_TO_DEVIATION = 0.9, 0.608

#: ns; smaller steps are followed like drift: 0.1 ms is 0.5 degrees at 15 Hz.
LEAST_STEP = 100_000
#: s of samples that are averaged, their least number, and how many averages are kept.
CHUNK, FEWEST, KEPT = 0.1, 8, 40
#: Relative rate at which clocks are slewed (``adjtime`` uses 500 ppm): over two chunks that is no step.
SLEW = 5.0e-4
#: Times the usual change between chunks that a step exceeds, and chunks that this scale needs at least.
CERTAIN, SCALED = 8.0, 5
#: Chunks that a lasting step spans: one ahead of it, one that holds it, two behind it.
SPAN = 4
#: s of the lag's average, and standard deviations of it that prove a change.
LAG_MEMORY, LAG_CERTAIN = 1.0, 4.0
#: Standard deviations with which a single lag counts at most.
LAG_CLIP = 5.0
#: Error of a mean over a time T (s) of what rises evenly over L s and then falls back: lags of messages that
#: come in lumps, stamps of bursts. Over a part of L the sum is off by L^2 / 8 at most. That is 1.5 times the
#: variance, L^2 / 12.
LUMP = 1.5

Averages = Sequence[float] | Array


@dataclass(slots=True)
class SampleClock:
    """The straight line through the stamps of equidistant samples, with fading memory.

    A g-h filter with the gains of the least-squares line (Brookner, Tracking and Kalman Filtering Made Easy,
    1998, section 1.2.10: growing memory), which stop to fall after ``MEMORY``.

    Attributes:
        base: ns, integer time that all others count from.
        period: ns between samples.
        index: the newest sample's number.
        time: ns, smoothed time of that sample, counted from ``base``.
        jitter: ns, standard deviation of the stamps about the line.
        phase_count: stamps that the phase is averaged over.

    """

    base: int
    period: float
    index: int
    time: float
    jitter: float
    phase_count: int
    _rate_count: int

    @classmethod
    def through(cls, stamps: Indices, indices: Indices, period: float | None = None) -> SampleClock:
        """Return the clock of the least-squares line through ``stamps`` (ns), each of shape (n,), n >= 3.

        ``period``: ns, where it is known.
        """
        base = int(stamps[0])
        times = (stamps - base).astype(np.float64)
        period = line_through(indices, times)[0] if period is None else period
        line, _ = on_line(indices, times, period)
        jitter = MEDIAN_TO_DEVIATION * float(np.median(np.abs(times - line)))
        return cls(base, period, int(indices[-1]), float(line[-1]), jitter, stamps.size, stamps.size)

    @property
    def rate(self) -> float:
        """Samples a second."""
        return 1e9 / self.period

    def ahead(self, stamp: int) -> float:
        """Return by how many ns ``stamp`` is later than the next sample is due."""
        return stamp - self.base - self.time - self.period

    def take(self, stamp: int, steps: int = 1) -> None:
        """Advance by ``steps`` samples, the last of which bears ``stamp`` (ns)."""
        limit = max(8, round(MEMORY * self.rate))
        rates = self._rate_count = min(self._rate_count + 1, limit)
        phases = self.phase_count = min(self.phase_count + 1, limit)
        due = self.time + steps * self.period
        error = stamp - self.base - due
        self.index += steps
        self.time = due + 2.0 * (2.0 * phases - 1.0) / (phases * (phases + 1.0)) * error
        self.period += 6.0 / (rates * (rates + 1.0)) * error / steps
        share = min(1.0, 1.0 / JITTER_SAMPLES)
        clipped = min(abs(error), JITTER_CLIP * max(self.jitter, 1.0))
        self.jitter = math.sqrt((1.0 - share) * self.jitter**2 + share * clipped**2)

    def skip(self) -> None:
        """Advance by a sample whose stamp says nothing."""
        self.index += 1
        self.time += self.period

    def resume(self, stamp: int, steps: int) -> None:
        """Go on at ``stamp`` after a gap: the rate stays, the phase begins again."""
        self.index += steps
        self.time = float(stamp - self.base)
        self.phase_count = 1

    def times(self, indices: Indices, base: int) -> Array:
        """Return the times of samples in ns from ``base``; both of shape (n,)."""
        return np.asarray(self.time + (indices - self.index) * self.period + float(self.base - base))

    def indices(self, times: Array, base: int) -> Array:
        """Return which sample, as a real number, was due at ``times`` (ns from ``base``); shape (n,)."""
        return np.asarray(self.index + (times - float(self.base - base) - self.time) / self.period)


class Change(enum.Enum):
    """Change of the stamps by a known amount, by what the lag shows."""

    CLOCK = "clock"  # the lag changed by as much: this sensor's clock was set
    COUNT = "count"  # the lag did not change, or there is none: samples were lost, or both clocks were set
    UNCERTAIN = "uncertain"  # the lag is too noisy, or the other sensor is silent


class Line(NamedTuple):
    """Line of a clock: the newest sample's number and time (ns), and ns between samples."""

    number: int
    time: float
    period: float


class Step(NamedTuple):
    """Step of a clock: by how many ns, and the line ahead of it."""

    by: float
    line: Line


@dataclass(slots=True)
class StepWatch:
    """Step watch of one sensor of ``rate`` (Hz): averages of residuals and lags (ns), and their usual change.

    Attributes:
        spread: ns, standard deviation of the residuals of the stamps that made the clock.
        lag: ns, average of the lag, NaN before the first. lag_deviation: its standard deviation.
        lag_scale: ns, usual change of the lag from one chunk to the next, as a standard deviation.
        lag_unrest: ns, large change of the lag over ``LAG_MEMORY``, as a standard deviation: what a delivery
            that stays late for longer than a chunk makes of the average.
        recent: ns, average of the newest residuals: what the clock has not followed yet while it is slewed.
        limit: ns, step of the averages that is certain, when one was looked for last.

    """

    rate: float
    spread: float = 0.0
    lag: float = math.nan
    lag_deviation: float = 0.0
    lag_scale: float = math.inf
    lag_unrest: float = math.inf
    recent: float = 0.0
    limit: float = math.inf
    size: int = field(init=False)
    period: float = field(init=False)
    _lag_count: int = 0
    _residuals: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    _lags: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    _chunk: list[tuple[float, float, float]] = field(default_factory=list)
    _lines: deque[tuple[Line, float]] = field(default_factory=lambda: deque(maxlen=SPAN))

    def __post_init__(self) -> None:
        self.size = max(FEWEST, round(CHUNK * self.rate))
        self.period = 1e9 / self.rate

    @property
    def unsure(self) -> int:
        """Newest samples in which a step may not have been found yet."""
        return (SPAN - 1) * self.size + len(self._chunk)

    @property
    def steady_lag(self) -> float:
        """Median of the lag's averages over some seconds, ns; NaN before there are so many."""
        return float(np.nanmedian(self._lags)) if len(self._lags) == KEPT and self._lag_count else math.nan

    def take(self, residual: float, lag: float, time: float, line: Line) -> Step | None:
        """Take a sample at ``time`` (ns) and the clock's line after it; return a step that has lasted.

        It has lasted for two chunks.
        """
        if math.isfinite(lag):
            self._lag_count = min(self._lag_count + 1, max(FEWEST, round(LAG_MEMORY * self.rate)))
            gain = 1.0 / self._lag_count
            off = 0.0 if math.isnan(self.lag) else lag - self.lag
            if self._lag_count > FEWEST:  # one message out of order says nothing of the others
                reach = LAG_CLIP * max(self.lag_deviation, 1e9 / self.rate)
                off = min(max(off, -reach), reach)
            self.lag = lag if math.isnan(self.lag) else self.lag + gain * off
            self.lag_deviation = math.sqrt((1.0 - gain) * self.lag_deviation**2 + gain * off**2)
        self.recent += (residual - self.recent) / self.size
        self._chunk.append((residual, lag, time - line.number * self.period))
        if len(self._chunk) < self.size:
            return None
        residuals, lags, off = np.array(self._chunk).T
        self._chunk.clear()
        lags = lags[np.isfinite(lags)]
        self._residuals.append(float(residuals.mean()))
        self._lags.append(float(lags.mean()) if lags.size else math.nan)
        self._lines.append((line, float(off.mean())))
        if lags.size:
            self.lag_scale = usual_change(self._lags)
            unrest = _changes(self._lags, max(1, round(LAG_MEMORY * self.rate / self.size)))
            self.lag_unrest = (
                LARGE_TO_DEVIATION * float(np.quantile(unrest, LARGE)) if unrest.size else math.inf
            )
        return self._step()

    def lag_error(self, count: int) -> float:
        """Return by how much (ns) the mean lag of ``count`` samples in a row may be off."""
        seconds = count / self.rate
        scale = self.lag_deviation
        if count >= self.size and len(self._lags) > SCALED:
            scale = min(scale, self.lag_scale / math.sqrt(2.0 * count / self.size))
            if math.isfinite(self.lag_unrest):
                scale = max(scale, self.lag_unrest)
        return math.hypot(LAG_CERTAIN * scale, lump_error(self.lag_deviation, seconds))

    def judge(self, step: float, lags: list[float], *, last: bool = False) -> Change:
        """Return what a ``step`` (ns) of the newest samples, whose lags are given, is.

        ``last``: no more lags are awaited: one of both explanations is excluded if its lag is off.
        """
        if math.isnan(self.lag):
            return Change.COUNT
        first = min(len(lags) // 2, self.size)  # the other clock may have been set as well, and be seen later
        newest = [lag for lag in lags[first:] if math.isfinite(lag)]
        if not newest:
            return Change.UNCERTAIN
        change = float(np.median(newest)) - self.lag
        error = LAG_CERTAIN * self.lag_deviation
        if len(newest) >= self.size and len(self._lags) > SCALED:
            # Messages that are delivered in lumps: an average over a chunk changes by less than single lags.
            change = float(np.mean(newest)) - self.lag
            error = min(error, math.hypot(self.lag_error(len(newest)), self.lag_error(self._lag_count)))
        if last and abs(change) > error >= abs(change - step):
            return Change.CLOCK
        if last and abs(change) <= error < abs(change - step):
            return Change.COUNT
        return _nearer(change, step, error)

    def judge_chunks(self, step: float) -> Change:
        """Return what a ``step`` (ns) found by ``take`` is."""
        lags = list(self._lags)
        change = 0.5 * (lags[-1] + lags[-2]) - lags[-SPAN]
        error = LAG_CERTAIN * self.lag_scale + lump_error(self.lag_deviation, CHUNK)
        return _nearer(change, step, error) if math.isfinite(change) else Change.UNCERTAIN

    def restart(self) -> None:
        """Begin the averages again, after a step."""
        self.recent = 0.0
        self._residuals.clear()
        self._lags.clear()
        self._lines.clear()
        self._chunk.clear()

    def _step(self) -> Step | None:
        means = list(self._residuals)
        if len(means) < SCALED + SPAN:
            return None
        # Chunks may hold parts of bursts.
        usual = step_limit(means[: 1 - SPAN], self.size / self.rate)
        limit = self.limit = max(usual, lump_error(self.spread, CHUNK))
        if not lasting_moves(means[-SPAN:])[0] > limit:
            return None
        # The line has followed the step in part: seen from the line ahead of it the step is whole.
        line, before = self._lines[0]
        behind = 0.5 * (self._lines[-2][1] + self._lines[-1][1])
        chunks = 0.5 * ((SPAN - 2) + (SPAN - 1))
        by = behind - before - chunks * self.size * (line.period - self.period)
        # Where the line alone has turned, no stamp has stepped.
        return Step(by, line) if abs(by) > LEAST_STEP else None


def _changes(means: Averages, apart: int = 1) -> Array:
    """Return by how much each average differs from the one ``apart`` later, ns, where both are known."""
    values = np.asarray(means, dtype=np.float64)
    changes = np.abs(values[apart:] - values[:-apart])
    return np.asarray(changes[np.isfinite(changes)])


def usual_change(means: Averages) -> float:
    """Return the usual change from one average to the next as a standard deviation, ns."""
    changes = _changes(means)
    return MEDIAN_TO_DEVIATION * float(np.median(changes)) if changes.size else math.inf


def step_limit(means: Averages, seconds: float) -> float:
    """Return the size (ns) of a step that the averages of chunks of so many ``seconds`` show for certain."""
    return max(LEAST_STEP + 2.0 * SLEW * 1e9 * seconds, CERTAIN * usual_change(means))


def lasting_moves(means: Averages) -> Array:
    """Return how far (ns) the averages, shape (n,), move behind each one for two chunks, 0 where they do not.

    Shape (n - ``SPAN`` + 1,).
    """
    row = np.asarray(means, dtype=np.float64)
    first, second = row[SPAN - 2 : -1] - row[: 1 - SPAN], row[SPAN - 1 :] - row[: 1 - SPAN]
    return np.where(np.sign(first) == np.sign(second), np.minimum(np.abs(first), np.abs(second)), 0.0)


def lump_error(deviation: float, seconds: float) -> float:
    """Return by how much (ns) the mean over ``seconds`` of what comes in lumps may be off.

    ``deviation`` (ns): standard deviation of single values.
    """
    return LUMP * 1e-9 * deviation**2 / seconds


def _nearer(change: float, step: float, error: float) -> Change:
    if error > 0.5 * abs(step):
        return Change.UNCERTAIN
    return Change.CLOCK if abs(change - step) < abs(change) else Change.COUNT
