"""Noise of both channels and band of the excitation, from the record itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from .spectra import floor_of

Array = NDArray[np.float64]

#: Share of the power that the excitation's band holds.
BAND_SHARE = 0.999


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Noise and excitation of one record.

    Attributes:
        body, spool: one-sided power density of the noise, (m/s^2)^2/Hz; the spool's is an upper bound, since
            harmonics of friction reach up there.
        low, high: band that holds nearly all of the excitation, Hz.
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


def noise_of(body: Array, spool: Array, rate: float) -> ChannelNoise:
    """Return noise and excitation band of readings (m/s^2, shape (n,)) that come at ``rate`` (Hz)."""
    piece = int(min(body.size, max(256, 2 ** round(np.log2(rate)))))
    frequency, density = signal.welch(body, rate, "hann", piece)
    noise, spool_noise = floor_of(density), floor_of(signal.welch(spool, rate, "hann", piece)[1])
    total = np.cumsum(np.maximum(density - 3.0 * noise, 0.0))
    if total[-1] <= 0.0:
        return ChannelNoise(noise, spool_noise, 0.0, 0.5 * rate, rate)
    share = total / total[-1]
    low = float(frequency[np.searchsorted(share, 1.0 - BAND_SHARE)])
    high = float(frequency[min(np.searchsorted(share, BAND_SHARE), frequency.size - 1)])
    return ChannelNoise(noise, spool_noise, low, high, rate)
