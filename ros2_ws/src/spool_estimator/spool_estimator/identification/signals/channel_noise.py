"""Noise of both channels and band of the excitation, from the record itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from .spectra import QUANTILE, floor_of

Array = NDArray[np.float64]

#: Share of the power that the excitation's band holds.
BAND_SHARE = 0.999
#: Band above the excitation, over its upper end, in which noise is looked at where an anti-alias filter
#: leaves none further up.
ABOVE = (1.3, 4.0)
#: Density over that of white noise from which noise is coloured, or cut off by a filter: 10 dB are more than
#: the density of any white noise scatters.
LOUDER = 10.0
#: Squared coherence of both channels from which the spool follows the body: chance gives as much to the mean
#: of 5 lines in 20 pieces in none of 1e9.
COHERENT = 0.5
#: Lines that the coherence is averaged over, and lines at least from which a level is taken.
NEIGHBOURS, FEWEST = 5, 8
#: Standard deviations by which the density below exceeds the one above where it is not of white noise alone,
#: and
#: standard deviation of a median over that of a mean, for many samples.
SURE, MEDIAN = 5.0, 1.25


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Noise and excitation of one record.

    Attributes:
        body, spool: one-sided power density of the noise, (m/s^2)^2/Hz.
        low, high: band that holds nearly all of the excitation, Hz.
        rate: samples per second.
        noisy_below: Hz, below which coloured noise drowns what the spool has of the body's motion; 0 where
            that noise is white.
        spool_is_bound: the spool's noise is an upper bound: its density falls with frequency even above the
            excitation, as it does where harmonics of dry friction reach up there, or no such band is left.
    """

    body: float
    spool: float
    low: float
    high: float
    rate: float
    noisy_below: float = 0.0
    spool_is_bound: bool = True

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
    spool_density = signal.welch(spool, rate, "hann", piece)[1]
    noise, spool_noise = floor_of(density), floor_of(spool_density)
    total = np.cumsum(np.maximum(density - 3.0 * noise, 0.0))
    if total[-1] <= 0.0:
        return ChannelNoise(noise, spool_noise, 0.0, 0.5 * rate, rate)
    share = total / total[-1]
    low = float(frequency[np.searchsorted(share, 1.0 - BAND_SHARE)])
    high = float(frequency[min(np.searchsorted(share, BAND_SHARE), frequency.size - 1)])
    near = (frequency > ABOVE[0] * high) & (frequency < min(ABOVE[1] * high, 0.45 * rate))
    if np.count_nonzero(near) >= FEWEST:
        level = float(np.quantile(density[near], QUANTILE))
        if level > LOUDER * noise:
            noise = level
            spool_noise = max(spool_noise, float(np.quantile(spool_density[near], QUANTILE)))
    edge = _coherent_from(body, spool, rate, piece)
    below = (frequency > 0.5) & (frequency < 0.8 * edge)
    drowned = below.any() and float(np.median(spool_density[below])) > LOUDER * spool_noise
    bound = _falls(frequency, spool_density, (ABOVE[0] * high, 0.45 * rate), body.size / piece)
    return ChannelNoise(noise, spool_noise, low, high, rate, 0.8 * edge if drowned else 0.0, bound)


def _falls(frequency: Array, density: Array, band: tuple[float, float], pieces: float) -> bool:
    """Return whether a density, averaged over ``pieces``, is higher in the lower half of a band (Hz)."""
    middle = 0.5 * (band[0] + band[1])
    lower = density[(frequency > band[0]) & (frequency < middle)]
    upper = density[(frequency >= middle) & (frequency < band[1])]
    if min(lower.size, upper.size) < FEWEST:
        return True
    scatter = MEDIAN * float(np.sqrt((1.0 / lower.size + 1.0 / upper.size) / max(pieces, 1.0)))
    return float(np.median(lower)) > (1.0 + SURE * scatter) * float(np.median(upper))


def _coherent_from(body: Array, spool: Array, rate: float, piece: int) -> float:
    """Return the lowest frequency (Hz) at which the spool follows the body, 0 where that is not known."""
    frequency, one = signal.welch(body, rate, "hann", piece)
    other = signal.welch(spool, rate, "hann", piece)[1]
    cross = signal.csd(body, spool, rate, "hann", piece)[1]
    width = np.ones(NEIGHBOURS) / NEIGHBOURS
    one, other, real, imaginary = (
        np.convolve(row, width, mode="same") for row in (one, other, cross.real, cross.imag)
    )
    coherent = (real**2 + imaginary**2) / np.maximum(one * other, 1e-300) > COHERENT
    return float(frequency[np.argmax(coherent)]) if coherent.any() and body.size > 10 * piece else 0.0
