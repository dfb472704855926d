"""Sample clock: which time the n-th sample of a sensor was taken, from stamps that jitter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: s of stamps that the phase and the rate are averaged over once there are so many. Stamps that jitter by J
#: leave the phase 2 J / sqrt(samples in it) (standard error of a line's end), 10 us of 0.5 ms at 1 kHz, and
#: quartz clocks that warm up change their rate by less than 1e-6 meanwhile.
MEMORY = 10.0

#: Samples over which the size of the jitter is averaged, and how many times its size a stamp counts with.
JITTER_SAMPLES, JITTER_CLIP = 500, 5.0

#: Standard deviations in a median absolute deviation of normal errors.
MEDIAN_TO_DEVIATION = 1.4826


@dataclass(slots=True)
class SampleClock:
    """Sample clock: the straight line through the stamps of equidistant samples, with fading memory.

    A g-h filter with the gains of the least-squares line (Brookner, Tracking and Kalman Filtering Made Easy,
    1998, section 1.2.10: growing memory), which stop to fall after ``MEMORY``.

    Attributes:
        base: ns, integer time that all others count from.
        period: ns between samples.
        index: the newest sample's number.
        time: ns, smoothed time of that sample, counted from ``base``.
        jitter: ns, standard deviation of the stamps about the line.

    """

    base: int
    period: float
    index: int
    time: float
    jitter: float
    _rate_count: int
    _phase_count: int

    @classmethod
    def through(cls, stamps: NDArray[np.int64], indices: NDArray[np.int64]) -> SampleClock:
        """Return the clock of the least-squares line through ``stamps`` (ns), each of shape (n,), n >= 3."""
        base = int(stamps[0])
        times = (stamps - base).astype(np.float64)
        middle = indices.mean()
        offsets = indices - middle
        period = float(offsets @ times / (offsets @ offsets))
        line = times.mean() + period * offsets
        jitter = MEDIAN_TO_DEVIATION * float(np.median(np.abs(times - line)))
        return cls(base, period, int(indices[-1]), float(line[-1]), jitter, stamps.size, stamps.size)

    def turn(self, period: float, indices: NDArray[np.int64]) -> None:
        """Take ``period`` (ns) for that of the line through the samples ``indices``, whose mean stays."""
        self.time += (period - self.period) * float(indices[-1] - indices.mean())
        self.period = period

    @property
    def phase_count(self) -> int:
        """Stamps that the phase is averaged over."""
        return self._phase_count

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
        self._rate_count = min(self._rate_count + 1, limit)
        self._phase_count = min(self._phase_count + 1, limit)
        due = self.time + steps * self.period
        error = stamp - self.base - due
        self.index += steps
        self.time = due + _phase_gain(self._phase_count) * error
        self.period += _rate_gain(self._rate_count) * error / steps
        share = min(1.0, 1.0 / JITTER_SAMPLES)
        clipped = min(abs(error), JITTER_CLIP * max(self.jitter, 1.0))
        self.jitter = math.sqrt((1.0 - share) * self.jitter**2 + share * clipped**2)

    def skip(self) -> None:
        """Advance by a sample whose stamp says nothing."""
        self.index += 1
        self.time += self.period

    def resume(self, stamp: int, steps: int) -> None:
        """Go on at ``stamp`` after a gap: the rate stays, the phase begins anew."""
        self.index += steps
        self.time = float(stamp - self.base)
        self._phase_count = 1

    def times(self, indices: NDArray[np.int64], base: int) -> Array:
        """Return the times of samples in ns from ``base``; both of shape (n,)."""
        return np.asarray(self.time + (indices - self.index) * self.period + float(self.base - base))

    def indices(self, times: Array, base: int) -> Array:
        """Return which sample, as a real number, was due at ``times`` (ns from ``base``); shape (n,)."""
        return np.asarray(self.index + (times - float(self.base - base) - self.time) / self.period)


def _phase_gain(count: int) -> float:
    return 2.0 * (2.0 * count - 1.0) / (count * (count + 1.0))


def _rate_gain(count: int) -> float:
    return 6.0 / (count * (count + 1.0))
