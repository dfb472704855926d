"""What usually stays of a gap, whatever a few windows do in which hits make the run chaotic."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def usual_excess(after: Sequence[Array], floor: Sequence[Array]) -> float:
    """Return what stays over what noise leaves, rms, in the median window.

    Args:
        after: errors of each window, m/s^2, shape (1, n).
        floor: what noise leaves of it.
    """
    left, noise = (np.array([float(np.sum(e**2)) for e in errors]) for errors in (after, floor))
    return float(np.median(np.sqrt(left / np.maximum(noise, 1e-30))))


def usual_share(before: Sequence[Array], after: Sequence[Array], floor: Sequence[Array]) -> float:
    """Return the share of the gap's amplitude, noise taken off, that stays in the usual window.

    The median over the windows, each with the weight of its gap: one window in which the spool hits a moment
    too early and goes another way from there does not count more than it lasts.

    Args:
        before, after: errors of each window without and with what is named, m/s^2, shape (1, n).
        floor: what noise leaves of it.
    """
    gap, left, noise = (np.array([float(np.sum(e**2)) for e in errors]) for errors in (before, after, floor))
    gap, left = np.maximum(gap - noise, 0.0), np.maximum(left - noise, 0.0)
    if not gap.any():
        return 0.0
    share = np.sqrt(left / np.maximum(gap, 1e-30))
    order = np.argsort(share)
    weight = np.cumsum(gap[order])
    return float(share[order][int(np.searchsorted(weight, 0.5 * weight[-1]))])
