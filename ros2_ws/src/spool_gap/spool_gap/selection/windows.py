"""Median window: what stays of a gap, whatever a few windows do in which hits make the run chaotic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]


def median_excess(after: Sequence[Array], floor: Sequence[Array]) -> float:
    """Error over what noise leaves, rms, in the median window.

    Args:
        after: errors of each window, m/s^2, shape (1, n).
        floor: what noise leaves of it.
    """
    left, noise = _powers(after), _powers(floor)
    return float(np.median(np.sqrt(left / np.maximum(noise, 1e-30))))


def median_share(before: Sequence[Array], after: Sequence[Array], floor: Sequence[Array]) -> float:
    """Share of the gap's amplitude, noise taken off, that stays in the median window.

    The median over the windows, each with the weight of its gap: one window in which the spool hits a moment
    too early and goes another way from there does not count more than it lasts.

    Args:
        before, after: errors of each window without and with what is named, m/s^2, shape (1, n).
        floor: what noise leaves of it.
    """
    noise = _powers(floor)
    gap, left = (np.maximum(_powers(errors) - noise, 0.0) for errors in (before, after))
    if not gap.any():
        return 0.0
    share = np.sqrt(left / np.maximum(gap, 1e-30))
    order = np.argsort(share)
    weight = np.cumsum(gap[order])
    return float(share[order][int(np.searchsorted(weight, 0.5 * weight[-1]))])


def trimmed_sum(gains: Array) -> float:
    """Sum of ``gains``, one a window, shape (w,), were its extremes like the others."""
    return gains.size * float(stats.trim_mean(gains, THRESHOLDS.extreme_windows))


def _powers(errors: Sequence[Array]) -> Array:
    return np.array([float(np.sum(error**2)) for error in errors])
