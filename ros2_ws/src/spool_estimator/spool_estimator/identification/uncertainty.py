"""Standard deviations of a fit: the sandwich form over blocks of the weighted residual.

They hold for noise of any colour and for noise whose strength changes along the record; how far the sensors'
timing is not known, and other doubts, are added.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from .fit_result import FitSettings
from .free_run import FreeRun
from .residuals import Residuals

Array = NDArray[np.float64]

#: s of the blocks over which the weighted residual's slopes are summed.
BLOCK = 0.5
#: Change of the whole weighted residual by a typical size below which an unknown does not show.
SHOWS = 1e-2


def fit_covariance(
    residuals: Residuals, point: Array, scales: Array, settings: FitSettings, doubts: Sequence[Array] = ()
) -> Array:
    """Return the covariance of the u unknowns at ``point`` (u,), shape (u, u).

    Args:
        residuals: weighed by their spectrum.
        point: where the descent ended.
        scales: typical sizes, shape (u,); an unknown whose typical size hardly shows has infinite variance.
        settings: how well the sensors' timing is known, and whether it was fitted.
        doubts: changes of the point, shape (u,) each, that other readings of the record give.
    """
    residual = residuals.at(point)
    slopes = residuals.central_slopes(point)
    shown = np.linalg.norm(slopes * scales, axis=0) > SHOWS
    covariance = np.diag(np.where(shown, 0.0, math.inf))
    slopes = slopes[:, shown]
    if not shown.any():
        return covariance
    told = covariance_of(slopes, residual, _blocks(residuals.run, residual.size))
    shifts = [doubt[shown] for doubt in doubts]
    if settings.timing > 0.0 and not settings.fit_delay:
        late = residuals.at_delay(point, settings.timing * residuals.run.records[0].sample_period)
        shifts.append(np.linalg.lstsq(slopes, late - residual, rcond=None)[0])
    for shift in shifts:
        told += np.outer(shift, shift)
    covariance[np.ix_(shown, shown)] = told
    return covariance


def covariance_of(slopes: Array, residual: Array, blocks: Sequence[slice]) -> Array:
    """Return the covariance of a least-squares point, shape (u, u).

    It is that of a weighted residual that is white with variance 1. Where the blocks show more spread (the
    sandwich form; noise whose strength changes along the record, errors of the model), it is as large as they
    show, and a little more where they are few (the variance of Student's t).

    Args:
        slopes: Jacobian, shape (n, u), of full rank.
        residual: at the point, shape (n,), weighed.
        blocks: pieces of the samples that hardly depend on each other.
    """
    bread = np.linalg.inv(slopes.T @ slopes)
    scores = np.array([slopes[block].T @ residual[block] for block in blocks])
    scores -= scores.mean(axis=0)
    count = len(blocks)
    sandwich = bread @ (scores.T @ scores) @ bread * count / max(1, count - slopes.shape[1])
    # Where most of what is known of an unknown comes from: its share in each block.
    shares = np.array([np.sum((slopes[block] @ bread) ** 2, axis=0) for block in blocks])
    worth = shares.sum(axis=0) ** 2 / np.sum(shares**2, axis=0)
    shown_spread = np.diag(sandwich) / np.diag(bread) * (1.0 + 2.0 / worth)
    grown = np.sqrt(np.maximum(1.0, shown_spread))
    return np.asarray(bread * np.outer(grown, grown))


def _blocks(run: FreeRun, total: int) -> list[slice]:
    blocks: list[slice] = []
    offset = 0
    for window in run.windows:
        size = int(fft.next_fast_len(window.measured.size, real=True))
        length = max(8, round(BLOCK / run.records[window.record].sample_period))
        count = max(1, window.measured.size // length)
        edges = offset + size * np.arange(count + 1) // count
        blocks += [
            slice(low, high) for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        offset += size
    assert offset == total
    return blocks


def standard_deviations(covariance: Array) -> Array:
    """Return the square roots of the diagonal, shape (p,); NaN where rounding left no variance."""
    variances = np.diag(covariance)
    return np.asarray(np.sqrt(np.where(variances >= 0.0, variances, np.nan)))
