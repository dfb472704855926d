"""Power densities: smoothed over frequency, their noise floor, and that of a residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

#: Quantile of a smoothed density that stands for its noise floor: harmonics reach into the other lines.
QUANTILE = 0.25
#: s of the pieces that the residual's spectrum is averaged over.
SPECTRUM_PIECE = 2.0


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density of a residual, (m/s^2)^2/Hz, at ``frequency`` (Hz), both shape (f,)."""

    frequency: Array
    density: Array

    def at(self, frequency: Array) -> Array:
        """Return the density at ``frequency``, same shape."""
        return np.interp(frequency, self.frequency, self.density)


def smoothed(density: Array, least: int, share: float = 0.05) -> Array:
    """Return ``density`` averaged over ``share`` of the frequency, and ``least`` lines, on both sides."""
    half = np.maximum(least, (share * np.arange(density.size)).astype(np.int64))
    total: Array = np.concatenate([[0.0], np.cumsum(density)])
    low = np.maximum(0, np.arange(density.size) - half)
    high = np.minimum(density.size, np.arange(density.size) + half + 1)
    return np.asarray((total[high] - total[low]) / (high - low))


def floor_of(density: Array) -> float:
    """Return the noise floor: the level of the quieter lines of the upper half of ``density``."""
    upper = density[density.size // 2 : max(density.size // 2 + 1, int(0.97 * density.size))]
    width = max(1, upper.size // 40)
    smooth = np.convolve(upper, np.full(width, 1.0 / width), mode="valid")
    return max(float(np.quantile(smooth, QUANTILE)), 1e-30)


def residual_spectrum(rows: Sequence[Array], sample_period: float) -> Spectrum:
    """Return the smoothed spectrum of the residuals ``rows``, one (n,) for each window.

    ``sample_period`` in s.
    """
    piece = min(*(row.size for row in rows), max(16, round(SPECTRUM_PIECE / sample_period)))
    densities = []
    for row in rows:
        frequency, density = signal.welch(row, 1.0 / sample_period, "hann", piece, detrend=False)
        densities.append(density)
    # Noise is smooth, and weights must not follow chance.
    smooth = smoothed(np.average(densities, axis=0, weights=[row.size for row in rows]), 2)
    return Spectrum(np.asarray(frequency), np.maximum(smooth, 1e-6 * float(smooth.max()) + 1e-30))
