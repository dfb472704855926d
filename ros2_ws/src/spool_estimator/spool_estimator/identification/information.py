"""Bayesian information criterion of what a fitted model leaves, for coloured residuals.

Whittle's likelihood of a residual with power density S(f) is a sum of log S over the lines of its spectrum.
For a residual of n independent lines in the band and p parameters

    BIC = n mean(log S) + p log n

up to a constant that all models of one set of data share. For a white residual it is the known n log(rms^2) +
p log n. Every model is judged on all samples in the band, jumps of the friction included.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from spool_estimator.identification.signals.spectra import residual_spectrum

from .residuals import HIGHEST_SHARE, Residuals

Array = NDArray[np.float64]


def information_criterion(residuals: Residuals, point: Array, parameters: int) -> tuple[float, float]:
    """Return BIC at ``point`` and the number of independent samples n that it counts.

    Args:
        residuals: gives windows and band.
        point: fitted values, shape (u,).
        parameters: how many of them the data tell.
    """
    run = residuals.run
    responses = residuals.respond(point[np.newaxis])
    total, count = 0.0, 0.0
    for record, entry in enumerate(run.records):
        rows = [
            response.means[0] - window.measured_means
            for response, window in zip(responses, run.windows, strict=True)
            if window.record == record
        ]
        if not rows:
            continue
        spectrum = residual_spectrum(rows, entry.sample_period)
        high = min(residuals.band[1], HIGHEST_SHARE * entry.sample_rate)
        inside = (spectrum.frequency >= residuals.band[0]) & (spectrum.frequency <= high)
        seconds = sum(row.size for row in rows) * entry.sample_period
        samples = 2.0 * seconds * (high - residuals.band[0])
        total += samples * float(np.mean(np.log(spectrum.density[inside])))
        count += samples
    return total + parameters * math.log(max(count, 2.0)), count
