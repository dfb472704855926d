"""Kernels over the samples of a block: outliers, and channels that stand still.

A sample is impossible where two things hold: it lies far outside of the span of the last seconds, and it is
further from the last good sample than that span allows in one step. It is replaced by the line through the
two good samples before it, so that the other samples of its block can be used. Vibration that grows, and hits
at a stop, reach a new level over several samples or stay there; a row of more than ``WIDEST`` samples is
believed, unless no accelerometer reads so much. Each sample is judged by those before it, so the result does
not depend on the split into blocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block, Samples
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

#: s of a chunk whose lowest and highest samples are kept, chunks that are kept, and chunks from which the
#: span of the signal is known. It is that of all chunks but the RANK most extreme ones, which may hold a
#: disturbance; a machine that starts to shake is known within half a second.
CHUNK, CHUNKS, KNOWN, RANK = 0.1, 32, 3, 3
#: Half spans of the signal from its middle, and from the last good sample, beyond which a sample is
#: impossible. Hits at a stop reach 6 half spans, over several samples.
FAR = 10.0
#: m/s^2, 5 g: nothing smaller is impossible; a machine that starts to shake reaches less in one sample.
LEAST = 50.0
#: m/s^2, 200 g, more than accelerometers for machines read: impossible before the span of the signal is
#: known, and in rows of any length.
UNKNOWN = 2000.0
#: Samples in a row that are left out at most; a longer row is a new level, not outliers.
WIDEST = 3

#: Places in the numbers of a channel: last good sample, the one before it, samples left out in a row, lowest
#: and highest of the present chunk, samples in it, chunks kept, middle and half span of the signal.
_LAST, _BEFORE, _ROW, _LOW, _HIGH, _FILLED, _KEPT, _MIDDLE, _HALF = range(9)

#: s for which both channels, or one of them, may stand still. A vibration of 5 Hz that a coarse converter
#: reads stands at its tops for up to 30 ms; one channel alone may clip, at its tops as well.
BOTH_STAND, ONE_STANDS = 0.05, 0.2
#: Equal samples in a row at least, and shares of the times above from which the newest samples are doubtful.
STANDING_LEAST, DOUBTFUL = 8, 0.1
BODY, SPOOL, BOTH = range(3)


class Outlier(NamedTuple):
    """The sample ``value`` (m/s^2) of ``channel`` at ``stamp`` (ns).

    ``half_span`` (m/s^2) is half the span of the signal in the seconds before, NaN where it was not known.
    """

    stamp: int
    channel: str
    value: float
    half_span: float


@dataclass(slots=True)
class OutlierFilter:
    """Replaces impossible samples in the accepted blocks of one stream, and counts them.

    Attributes:
        body, spool: samples left out of each channel since the start.
        first: the first outlier of the newest block, ``None`` where it has none.

    """

    body: int = 0
    spool: int = 0
    first: Outlier | None = None
    _period: float = 0.0
    _numbers: Array = field(default_factory=lambda: np.zeros((2, 9)), compare=False)
    _chunks: Array = field(default_factory=lambda: np.zeros((2, 2, CHUNKS)), compare=False)

    @property
    def count(self) -> int:
        """Samples left out since the start."""
        return self.body + self.spool

    def restart(self, period: float) -> None:
        """Start again after a gap, with samples ``period`` s apart; the span of the signal stays known."""
        numbers = self._numbers
        numbers[:, (_LAST, _BEFORE)] = math.nan
        numbers[:, (_ROW, _FILLED)] = 0.0
        self._period = period

    def cleaned(self, block: Block, *, restarts: bool) -> Block:
        """Return ``block`` with impossible samples replaced; ``block`` itself where it has none.

        ``restarts``: it follows the last one behind a gap.
        """
        if restarts or block.sample_period != self._period:
            self.restart(block.sample_period)
        size = max(1, round(CHUNK / block.sample_period))
        rows, self.first = [], None
        for channel, (name, row) in enumerate((("body", block.body), ("spool", block.spool))):
            out = np.empty(row.size, np.float32)
            count, place, half = leave_out(row, size, self._numbers[channel], self._chunks[channel], out)
            rows.append(out if count else row)
            if not count:
                continue
            setattr(self, name, getattr(self, name) + count)
            stamp = block.stamp + round(place * block.sample_period * 1e9)
            if self.first is None or stamp < self.first.stamp:
                self.first = Outlier(stamp, name, float(row[place]), half)
        if self.first is None:
            return block
        return Block(
            block.stamp, block.sequence, block.sample_period, rows[0], rows[1], block.source, block.blocks
        )  # fmt: skip


def impossible(row: Array, period: float) -> NDArray[np.bool_]:
    """Return which samples of ``row`` (m/s^2, shape (n,), ``period`` s apart) are impossible.

    The span of the signal is known from the first sample on: the row is looked at twice.
    """
    size = max(1, round(CHUNK / period))
    samples = row.astype(np.float32)
    numbers, chunks, out = np.zeros(9), np.zeros((2, CHUNKS)), np.empty(row.size, np.float32)
    for first in (True, False):
        numbers[[_LAST, _BEFORE]] = math.nan
        numbers[[_ROW, _FILLED]] = 0.0
        # The backward look knows the span at the first samples, where the forward one begins.
        leave_out(samples[::-1].copy() if first else samples, size, numbers, chunks, out)
    return np.asarray(out != samples)


@compiled
def _ranked(values: Array, rank: int) -> float:
    """Return the value above ``rank`` smaller ones; numba takes a second to compile a sort."""
    left = values.copy()
    for place in range(rank + 1):
        smallest = place + np.argmin(left[place:])
        left[place], left[smallest] = left[smallest], left[place]
    return float(left[rank])


@compiled
def leave_out(row: Samples, size: int, numbers: Array, chunks: Array, out: Samples) -> tuple[int, int, float]:
    """Fill ``out`` with ``row``, impossible samples replaced; return how many, the first, and the half span.

    ``row`` and ``out`` have shape (n,); ``numbers``, shape (9,), and ``chunks``, the lowest and highest
    samples of the last chunks of ``size`` samples, shape (2, CHUNKS), are moved on in place.
    """
    count, first, seen = 0, -1, math.nan
    for i in range(row.size):
        sample = np.float64(row[i])
        last = numbers[_LAST]
        known = numbers[_KEPT] >= KNOWN
        limit = max(LEAST, FAR * numbers[_HALF]) if known else UNKNOWN
        far = abs(sample - (numbers[_MIDDLE] if known else 0.0)) > limit
        # At the very first sample there is nothing to step from.
        jumps = math.isnan(last) or abs(sample - last) > limit
        beyond = limit <= UNKNOWN < abs(sample)
        if far and jumps and (beyond or numbers[_ROW] < WIDEST):
            before = numbers[_BEFORE]
            if math.isnan(last):
                value = numbers[_MIDDLE] if known else 0.0
            elif math.isnan(before) or numbers[_ROW] >= WIDEST:
                value = last
            else:
                value = last + (numbers[_ROW] + 1.0) * (last - before)
            numbers[_ROW] += 1.0
            out[i] = value
            if count == 0:
                first = i
                seen = numbers[_HALF] if known else math.nan
            count += 1
        else:
            # A line over a row that was left out has no slope between neighbours.
            numbers[_BEFORE] = sample if numbers[_ROW] > 0.0 else last
            numbers[_LAST] = sample
            numbers[_ROW] = 0.0
            out[i] = row[i]
            if numbers[_FILLED] == 0.0:
                numbers[_LOW] = numbers[_HIGH] = sample
            else:
                numbers[_LOW], numbers[_HIGH] = min(numbers[_LOW], sample), max(numbers[_HIGH], sample)
            numbers[_FILLED] += 1.0
            if numbers[_FILLED] >= size:
                place = int(numbers[_KEPT]) % chunks.shape[1]
                chunks[0, place], chunks[1, place] = numbers[_LOW], numbers[_HIGH]
                numbers[_KEPT] += 1.0
                numbers[_FILLED] = 0.0
                kept = min(int(numbers[_KEPT]), chunks.shape[1])
                rank = min(kept // 2, RANK)
                low = _ranked(chunks[0, :kept], rank)
                high = -_ranked(-chunks[1, :kept], rank)
                numbers[_MIDDLE], numbers[_HALF] = 0.5 * (low + high), 0.5 * (high - low)
    return count, first, seen


class StandingArrays(NamedTuple):
    """Arrays of a :class:`StandingWatch`, which kernels move on in place."""

    trailing: NDArray[np.int64]
    longest: NDArray[np.int64]
    last: Samples
    limits: NDArray[np.int64]


@dataclass(slots=True)
class StandingWatch:
    """Counts for how long body, spool and both have not changed, however they are split.

    Attributes:
        trailing: changes that did not happen up to the newest sample: of body, of spool, of both, shape (3,).
        longest: the most of them in a row within the samples taken last, with those before, shape (3,).

    """

    sample_period: float
    trailing: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    longest: NDArray[np.int64] = field(default_factory=lambda: np.zeros(3, np.int64))
    _last: Samples = field(default_factory=lambda: np.full(2, np.nan, np.float32))
    _limits: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        counts = [round(time / self.sample_period) for time in (ONE_STANDS, ONE_STANDS, BOTH_STAND)]
        self._limits = np.maximum(counts, STANDING_LEAST)

    def reset(self) -> None:
        """Forget every sample."""
        self._last.fill(np.nan)
        self.trailing.fill(0)
        self.longest.fill(0)

    def take(self, samples: Samples) -> None:
        """Take samples of shape (2, n), m/s^2."""
        scan(samples, self.arrays)

    @property
    def arrays(self) -> StandingArrays:
        """What the kernels move on in place."""
        return StandingArrays(self.trailing, self.longest, self._last, self._limits)

    @property
    def stands(self) -> bool:
        """Whether among the samples taken last some are of an acquisition that stands still."""
        return bool((self.longest >= self._limits).any())

    @property
    def doubtful(self) -> bool:
        """Whether the newest samples may be the first ones of a standstill."""
        return bool((self.trailing >= np.maximum(3, DOUBTFUL * self._limits)).any())

    @property
    def age(self) -> float:
        """Time since the standstill that lasts began, s; 0 where none does."""
        standing = self.trailing[self.trailing >= self._limits]
        return float(standing.max()) * self.sample_period if standing.size else 0.0


@compiled
def scan(samples: Samples, watch: StandingArrays) -> bool:
    """Take samples as :class:`StandingWatch` does; return whether some are of a standstill."""
    trailing, longest, last, limits = watch
    longest[:] = 0
    for i in range(samples.shape[1]):
        body, spool = samples[BODY, i] == last[BODY], samples[SPOOL, i] == last[SPOOL]
        trailing[BODY] = trailing[BODY] + 1 if body else 0
        trailing[SPOOL] = trailing[SPOOL] + 1 if spool else 0
        trailing[BOTH] = trailing[BOTH] + 1 if body and spool else 0
        for which in range(3):
            longest[which] = max(longest[which], trailing[which])
        last[BODY], last[SPOOL] = samples[BODY, i], samples[SPOOL, i]
    stands = False
    for which in range(3):
        stands = stands or longest[which] >= limits[which]
    return stands
