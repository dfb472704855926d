"""Whiteness of a residual: its autocorrelation with the band of white noise, and its spectrum.

Box, G. E. P., Jenkins, G. M.: Time Series Analysis (1976), section 2.1.6: the autocorrelation of n samples of
white noise has a standard deviation of 1/sqrt(n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95

Array = NDArray[np.float64]

#: s of lag that are looked at: some periods of the slowest spool.
LONGEST_LAG = 0.25
#: Samples from which an autocorrelation is worth drawing.
LEAST = 200


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Autocorrelation and spectrum of a residual.

    Attributes:
        lag: s, shape (l,), from one sample on.
        correlation: at each lag, shape (l,).
        band: half width that white noise keeps to at 95 of 100 lags.
        frequency: Hz, shape (f,).
        density: power density, unit^2/Hz, shape (f,).
        rms: of the residual, in its unit.
        samples: how many.
    """

    lag: Array
    correlation: Array
    band: float
    frequency: Array
    density: Array
    rms: float
    samples: int

    @property
    def outside(self) -> float:
        """Share of the lags outside of the band; 0.05 for white noise."""
        return float(np.mean(np.abs(self.correlation) > self.band))


def whiteness(rows: Sequence[Array], period: float) -> Whiteness:
    """Return the whiteness of residual ``rows``, each without a gap, samples ``period`` s apart.

    Raises:
        InputError: too few samples, or nothing is left over at all.
    """
    samples = sum(row.size for row in rows)
    shortest = min((row.size for row in rows), default=0)
    lags = min(round(LONGEST_LAG / period), shortest // 4)
    if samples < LEAST or lags < 8:
        raise InputError(f"{samples} samples of the residual are too few for an autocorrelation")
    mean = float(np.concatenate(rows).mean())
    centred = [np.asarray(row - mean) for row in rows]
    products = np.asarray(np.sum([_products(row, lags) for row in centred], axis=0), dtype=np.float64)
    if not products[0] > 0.0:
        raise InputError("nothing at all is left over, as in a record that its own model made")
    piece = min(shortest, round(1.0 / period))
    found = [signal.welch(row, 1.0 / period, "hann", piece, detrend=False) for row in centred]
    density = np.average([one for _, one in found], axis=0, weights=[row.size for row in rows])
    return Whiteness(
        np.asarray(period * np.arange(1, lags + 1), dtype=np.float64),
        np.asarray(products[1:] / products[0]),
        Z_95 / math.sqrt(samples),
        np.asarray(found[0][0]),
        np.asarray(density, dtype=np.float64),
        float(np.sqrt(products[0] / samples)),
        samples,
    )


def _products(row: Array, lags: int) -> Array:
    """Return the sums of the products of ``row`` with itself 0 to ``lags`` samples later."""
    length = fft.next_fast_len(row.size + lags, real=True)
    lines = fft.rfft(row, length)
    return np.asarray(fft.irfft(lines * np.conj(lines), length)[: lags + 1])
