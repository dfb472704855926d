"""Noise of both channels and band of the drive, from the record itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from spool_identification.record import Record

Array = NDArray[np.float64]

#: Lower quartile of a chi-squared average over its mean, for the count of pieces that is usual here.
QUANTILE = 0.25
#: Power within which the drive's band holds this share.
BAND_SHARE = 0.999


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise and drive of one record.

    Attributes:
        body, spool: one-sided power density of the noise, (m/s^2)^2/Hz; the spool's is an upper bound, since
            harmonics of friction reach up there.
        low, high: band that holds nearly all of the drive, Hz.
        rate: samples per second.
    """

    body: float
    spool: float
    low: float
    high: float
    rate: float

    @property
    def body_rms(self) -> float:
        """White noise of the body's channel, m/s^2."""
        return float(np.sqrt(self.body * 0.5 * self.rate))

    @property
    def spool_rms(self) -> float:
        """White noise of the spool's channel, m/s^2."""
        return float(np.sqrt(self.spool * 0.5 * self.rate))


def noise_of(record: Record) -> Noise:
    """Return noise and drive band of ``record``."""
    piece = int(min(record.body.size, max(256, 2 ** round(np.log2(record.sample_rate)))))
    frequency, body = signal.welch(record.body, record.sample_rate, "hann", piece)
    _, spool = signal.welch(record.spool, record.sample_rate, "hann", piece)
    floor = floor_of(body)
    power = np.maximum(body - 3.0 * floor, 0.0)
    total = np.cumsum(power)
    if total[-1] <= 0.0:
        return Noise(floor, floor_of(spool), 0.0, 0.5 * record.sample_rate, record.sample_rate)
    share = total / total[-1]
    low = float(frequency[np.searchsorted(share, 1.0 - BAND_SHARE)])
    high = float(frequency[min(np.searchsorted(share, BAND_SHARE), frequency.size - 1)])
    return Noise(floor, floor_of(spool), low, high, record.sample_rate)


def floor_of(density: Array) -> float:
    """Return the level of the noise: what the quieter lines of the upper half of ``density`` lie at."""
    upper = density[density.size // 2 : max(density.size // 2 + 1, int(0.97 * density.size))]
    width = max(1, upper.size // 40)
    smooth = np.convolve(upper, np.full(width, 1.0 / width), mode="valid")
    return max(float(np.quantile(smooth, QUANTILE)), 1e-30)
