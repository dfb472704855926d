"""Sensor stream: the samples of one sensor in order, with what was lost, refused and in what rhythm."""

from __future__ import annotations

import enum
import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spool_stream.block_gate import LARGEST_SAMPLE

from .sample_clock import Array, SampleClock

#: Hz, rates that a sensor may have: the lowest is that of blocks (``block_gate.LONGEST_PERIOD``), the highest
#: far above what single messages can bring.
LOWEST_RATE, HIGHEST_RATE = 4.0, 1.0e5

#: s; a stamp further ahead is taken for a wrong one until CONFIRM follow it. Below, two prove a loss.
LONGEST_GAP, CONFIRM, PROVE_LOSS = 1.0, 10, 2

#: Periods, and times the jitter's standard deviation, by which a stamp may differ from what was due.
HALF, SURE = 0.5, 5.0

#: Share of a period that half of the steps between stamps may depart by where losses are counted from single
#: steps: half a period, where a step is miscounted, is then 6.7 standard deviations of a normal one.
REGULAR = 0.05

#: Samples that make a clock at least, and that it waits for at most, whatever the rate.
FEWEST, MOST = 8, 200_000

#: s of phase error that a rate of 1e-5 leaves over this gap at most is 1 us; over longer ones the phase is
#: taken from the first stamp after it.
KEEPS_PHASE = 0.1


class Refusal(enum.Enum):
    """Reason for which a sample is not used; the value is the text people read."""

    NO_TIME = "stamp is 0, negative or no number"
    NOT_FINITE = "the value is NaN, infinite or beyond 1e6 m/s^2"
    DUPLICATE = "stamp repeated"
    STRAY = "stamp that the next ones do not confirm"
    RATE = "sampled slower than 4 Hz or faster than 100 kHz"


@dataclass(slots=True)
class SensorStream:
    """Sensor stream: numbers the samples of one sensor and keeps the newest ``capacity`` of them.

    The stamps of the first ``settle`` s make the clock; from then on each sample has its number. One that is
    not finite keeps its number, with NaN for its value. ``update`` never raises.

    Attributes:
        settle: s of stamps that make the clock.
        capacity: samples kept.
        nominal: Hz, the rate where it is known, 0 where the stamps tell it.
        clock: ``None`` before it is made.
        generation: counts the clocks made: with a new one the numbers begin anew.
        restarts: how often the stamps went on elsewhere: a clock was set, or silence above ``LONGEST_GAP``.
        received: messages so far. lost: samples that never came. refused: how many were, by reason.
        newest: ns, stamp of the newest sample taken; 0 before the first.

    """

    settle: float
    capacity: int
    nominal: float = 0.0
    clock: SampleClock | None = None
    generation: int = 0
    restarts: int = 0
    received: int = 0
    lost: int = 0
    refused: Counter[Refusal] = field(default_factory=Counter)
    newest: int = 0
    _first: list[tuple[int, float]] = field(default_factory=list)
    _held: list[tuple[int, float]] = field(default_factory=list)
    _ring: Array = field(init=False)

    def __post_init__(self) -> None:
        self._ring = np.full(self.capacity, np.nan)

    @property
    def oldest(self) -> int:
        """Number of the oldest sample kept."""
        return 0 if self.clock is None else max(0, self.clock.index - self.capacity + 1)

    def update(self, stamp: int, value: float) -> None:
        """Take a sample: its acquisition time (ns) and its value (m/s^2)."""
        self.received += 1
        if stamp <= 0:
            self.refused[Refusal.NO_TIME] += 1
            return
        if not abs(value) <= LARGEST_SAMPLE:
            self.refused[Refusal.NOT_FINITE] += 1
            value = math.nan
        if stamp == self.newest:
            self.refused[Refusal.DUPLICATE] += 1
        else:
            self._place(stamp, value)

    def values(self, indices: NDArray[np.int64]) -> Array:
        """Return samples by number, NaN where one is missing or not kept; any shape."""
        clock = self.clock
        if clock is None:
            return np.full(indices.shape, np.nan)
        kept = (indices >= self.oldest) & (indices <= clock.index)
        return np.where(kept, self._ring[indices % self.capacity], np.nan)

    def _place(self, stamp: int, value: float) -> None:
        clock = self.clock
        if clock is None:
            self._settle(stamp, value)
            return
        ahead = clock.ahead(stamp)
        if abs(ahead) <= max(HALF * clock.period, SURE * clock.jitter):
            self._drop_held()
            self._accept(stamp, value, 1)
            return
        if self._held and not 0 < stamp - self._held[-1][0] <= LONGEST_GAP * 1e9:
            self._drop_held()
        self._held.append((stamp, value))
        forward = 0.0 < ahead <= LONGEST_GAP * 1e9 or (
            ahead > 0.0 and self._held[0][0] - self.newest <= LONGEST_GAP * 1e9
        )
        if len(self._held) >= (PROVE_LOSS if forward else CONFIRM):
            self._go_on(forward)

    def _go_on(self, forward: bool) -> None:
        """Take the samples that were held: after a loss, or as the begin of a new clock."""
        held, self._held = self._held, []
        clock = self.clock
        assert clock is not None
        if not forward:
            self._restart(held)
            return
        stamp, value = held[0]
        steps = max(2, 1 + round(clock.ahead(stamp) / clock.period))
        self.lost += steps - 1
        self._accept(stamp, value, steps)
        for later in held[1:]:
            self._place(*later)

    def _accept(self, stamp: int, value: float, steps: int) -> None:
        clock = self.clock
        assert clock is not None
        if steps * clock.period > KEEPS_PHASE * 1e9:
            clock.resume(stamp, steps)
        else:
            clock.take(stamp, steps)
        self.newest = stamp
        self._put(clock.index, value, steps)

    def _put(self, index: int, value: float, steps: int) -> None:
        for hole in range(max(index - steps + 1, index - self.capacity + 1), index):
            self._ring[hole % self.capacity] = np.nan
        self._ring[index % self.capacity] = value

    def _settle(self, stamp: int, value: float) -> None:
        """Gather the first stamps; one that goes back or far ahead counts once others follow it."""
        if self._first and not 0 < stamp - self._first[-1][0] <= LONGEST_GAP * 1e9:
            if self._held and not 0 < stamp - self._held[-1][0] <= LONGEST_GAP * 1e9:
                self._drop_held()
            self._held.append((stamp, value))
            if len(self._held) >= CONFIRM:
                self.refused[Refusal.STRAY] += len(self._first)
                self._first, self._held = self._held, []
                self.newest = stamp
            return
        self._drop_held()
        self._first.append((stamp, value))
        self.newest = stamp
        span = 1e-9 * (stamp - self._first[0][0])
        if (span >= self.settle and len(self._first) >= FEWEST) or len(self._first) >= MOST:
            self._begin()

    def _begin(self) -> None:
        """Make the clock from the first stamps, and number their samples."""
        first, self._first = self._first, []
        stamps = np.array([stamp for stamp, _ in first], dtype=np.int64)
        differences = np.diff(stamps).astype(np.float64)
        period = 1e9 / self.nominal if self.nominal > 0.0 else float(np.median(differences))
        steps = np.ones(differences.size, dtype=np.int64)
        if np.median(np.abs(differences - period)) < REGULAR * period:
            steps = np.maximum(1, np.rint(differences / period)).astype(np.int64)
        indices = np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
        clock = SampleClock.through(stamps, indices)
        if not LOWEST_RATE <= clock.rate <= HIGHEST_RATE:
            self.refused[Refusal.RATE] += len(first)
            return
        self.lost += int(steps.sum()) - steps.size
        self.clock = clock
        self.generation += 1
        self._ring[:] = np.nan
        for (_, value), index in zip(first, indices, strict=True):
            self._ring[index % self.capacity] = value

    def _restart(self, first: list[tuple[int, float]]) -> None:
        self.clock, self._first = None, first
        self.restarts += 1
        self.newest = first[-1][0]

    def _drop_held(self) -> None:
        self.refused[Refusal.STRAY] += len(self._held)
        self._held.clear()
