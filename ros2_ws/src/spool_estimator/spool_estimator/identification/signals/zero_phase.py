"""Zero-phase conditioning of records: relative motion from two accelerations, without drift.

All columns pass one and the same linear operator, a gain over frequency without phase: a raised cosine from 0
at ``low_cut`` to 1 at twice that. Integration divides by i omega, so nothing drifts. A record goes on beyond
its ends as its mirror image through the end points; within ``1 / low_cut`` of the ends it is not to be used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

#: Samples beyond both ends that a delayed signal is interpolated from.
EDGE = 256


@dataclass(frozen=True, slots=True)
class ZeroPhase:
    """A zero-phase band-pass, the same for every column.

    Attributes:
        sample_period: s.
        low_cut: Hz, 0 gain below; full gain from twice this on.
        high_cut: Hz, full gain below; 0 gain from 1.25 times this on. Infinite for no upper edge.
    """

    sample_period: float
    low_cut: float
    high_cut: float = float("inf")

    @property
    def settling(self) -> int:
        """Samples at each end that the mirror images reach."""
        return round(1.0 / (self.low_cut * self.sample_period)) if self.low_cut > 0.0 else 0

    def gain(self, frequency: Array) -> Array:
        """Return the gain at ``frequency`` (Hz, >= 0), same shape."""
        gain = np.ones(frequency.shape)
        if self.low_cut > 0.0:
            gain *= _rise(frequency / self.low_cut - 1.0)
        if np.isfinite(self.high_cut):
            gain *= 1.0 - _rise(4.0 * (frequency / self.high_cut - 1.0))
        return gain

    def apply(self, columns: Array, integrations: int = 0, *, interval_means: bool = False) -> Array:
        """Return ``columns`` (..., n) filtered and integrated ``integrations`` times over time (s).

        With ``interval_means`` each value is the mean from its sample to the next one.
        """
        n = columns.shape[-1]
        reach = min(n - 1, 2 * self.settling + 16)
        length = fft.next_fast_len(n + 2 * reach, real=True)
        frequency = fft.rfftfreq(length, self.sample_period)
        response = self.gain(frequency).astype(np.complex128)
        if integrations:
            response[0] = 0.0
            response[1:] /= (2j * np.pi * frequency[1:]) ** integrations
        if interval_means:
            response *= interval_mean_response(frequency, self.sample_period)
        padding = [(0, 0)] * (columns.ndim - 1) + [(reach, reach)]
        continued = np.pad(columns, padding, mode="reflect", reflect_type="odd") if reach else columns
        filtered = fft.irfft(fft.rfft(continued, length, axis=-1) * response, length, axis=-1)
        return np.asarray(filtered[..., reach : reach + n])


def delayed(rows: Array, delay: float, period: float) -> Array:
    """Return ``rows`` (..., n), a sample every ``period`` s, later by ``delay`` s, band-limited between."""
    count = rows.shape[-1]
    reach = min(count - 1, EDGE)
    padding = [(0, 0)] * (rows.ndim - 1) + [(reach, reach)]
    padded = np.pad(rows, padding, mode="reflect", reflect_type="odd")
    frequency = np.fft.rfftfreq(padded.shape[-1], period)
    lines = np.fft.rfft(padded) * np.exp(-2j * np.pi * frequency * delay)
    return np.asarray(np.fft.irfft(lines, padded.shape[-1])[..., reach : reach + count])


def interval_mean_response(frequency: Array, sample_period: float) -> NDArray[np.complex128]:
    """Return what the mean over the interval after each sample makes of ``frequency`` (Hz), same shape."""
    turns = frequency * sample_period
    return np.asarray(np.sinc(turns) * np.exp(1j * np.pi * turns))


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """Motion of the spool in its body; every array has shape (n,).

    Attributes:
        displacement, velocity, acceleration: relative, m, m/s, m/s^2.
        spool: acceleration of the spool itself, m/s^2.
        settling: samples at each end that are not to be used.
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    spool: Array
    settling: int


def relative_motion(body: Array, spool: Array, conditioning: ZeroPhase) -> RelativeMotion:
    """Return the relative motion from both accelerations (m/s^2, shape (n,))."""
    relative = spool - body
    return RelativeMotion(
        conditioning.apply(relative, 2),
        conditioning.apply(relative, 1),
        conditioning.apply(relative),
        conditioning.apply(spool),
        conditioning.settling,
    )


def _rise(share: Array) -> Array:
    """Return the raised cosine from 0 (share <= 0) to 1 (share >= 1)."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0)))
