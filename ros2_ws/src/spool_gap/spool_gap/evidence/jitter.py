"""Sampling jitter: noise that grows with the slope of the reading.

A reading taken too early or too late is off by slope times time. That is noise to any model; what shows it
is that it comes and goes with the slope, above the band of the excitation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import minimize
from spool_estimator.identification.nuisances.record_nuisance import Nuisance

from spool_gap.likelihood.prediction import Prediction

Array = NDArray[np.float64]

#: Lower end of the band over the excitation's upper end and over the sample rate; upper end over that rate.
ABOVE, LOWER, UPPER = 2.0, 0.1, 0.45
#: Share of that band in all frequencies below which nothing shows.
NARROWEST = 0.15
#: Twice the log likelihood ratio, and share of the noise that grows with the slope, from which there is
#: jitter: chosen on blind cases other than the published ones.
EVIDENCE, SHARE = 60.0, 0.2
CHECK = "the clock that takes the samples: a separate timer instead of a program's loop"


def jitter_of(parts: Sequence[Prediction], rows: Sequence[Array]) -> Nuisance | None:
    """Return the scatter of the sampling instants of the spool's channel, ``None`` where there is none.

    Args:
        parts: the records.
        rows: measured and predicted acceleration of each, m/s^2, shape (2 or more, n).
    """
    squares, slopes, shares = [], [], []
    for part, row in zip(parts, rows, strict=True):
        rate, error = 1.0 / part.period, row[0] - row[1]
        lines = fft.rfftfreq(error.size, part.period)
        band = (lines > max(ABOVE * part.readings.noise.high, LOWER * rate)) & (lines < UPPER * rate)
        if band.mean() < NARROWEST:
            continue
        left = fft.irfft(fft.rfft(error) * band, error.size)
        inside = part.counted > 0.5
        inside[: inside.size // 20] = inside[-(inside.size // 20) :] = False
        squares.append(left[inside] ** 2 / band.mean())
        slopes.append((np.gradient(row[1]) * rate)[inside] ** 2)
        shares.append(float(band.mean()))
    if not squares:
        return None
    square, slope = np.concatenate(squares), np.concatenate(slopes)
    whole, steepest = float(square.mean()), float(slope.mean())
    if whole <= 0.0 or steepest <= 0.0:
        return None
    square, slope = square / whole, slope / steepest

    def unlikely(powers: Array) -> float:
        power = np.exp(powers[0]) + np.exp(powers[1]) * slope
        return float(np.sum(np.log(power) + square / power))

    found = minimize(unlikely, np.log([0.5, 0.5]), method="Nelder-Mead")
    constant, growing = np.exp(found.x).tolist()
    # Samples of a band that is a part of all frequencies count as that part of them.
    evidence = float(np.mean(shares)) * (square.size - float(found.fun))
    if evidence < EVIDENCE or growing < SHARE * (constant + growing):
        return None
    averaged = math.sqrt(parts[0].period / parts[0].readings.period)
    return Nuisance("jitter", "spool", averaged * math.sqrt(growing * whole / steepest), "s", CHECK)


def sentence(found: Nuisance) -> str:
    """Return what the jitter ``found`` is on the machine."""
    return (
        "the noise of the spool's channel grows with the slope of the reading, as where samples are taken "
        f"{1e3 * found.size:.2g} ms (rms) too early or too late: check the clock that takes them"
    )
