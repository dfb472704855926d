"""Whether a channel clips: its tops are flat as those of no wave are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Row = NDArray[np.floating[Any]]

#: Depths, as a share of half the span, of the strip at a channel's extremes that a flat top fills.
DEPTHS = (0.002, 0.02)

#: Times as long in that strip as in those below it that no wave spends there.
FLATTER = 6


def flat_share(samples: Row) -> float:
    """Return the share of ``samples``, shape (n,), on a flat top at the upper or lower extreme."""
    low, high = float(samples.min()), float(samples.max())
    half = 0.5 * (high - low)
    return flat_top(samples, high, half) + flat_top(-samples, -low, half) if half > 0.0 else 0.0


def flat_top(samples: Row, peak: float, half: float) -> float:
    """Return the share of ``samples`` on a flat top at ``peak``, 0 for the top of any wave.

    A sine spends as long within a depth below its peak as in the strip from there to four times that depth,
    the flattest sum of two waves (a top with two humps) 4.4 times as long; a clipped one spends much more,
    and neighbours of each sample in the strip lie in it too.
    """
    for depth in DEPTHS:
        at_top = samples >= peak - depth * half
        count = int(np.count_nonzero(at_top))
        pairs = int(np.count_nonzero(at_top[1:] & at_top[:-1]))
        triples = int(np.count_nonzero(at_top[2:] & at_top[1:-1] & at_top[:-2]))
        below = int(np.count_nonzero(samples >= peak - 4.0 * depth * half)) - count
        # A wave whose period is a whole number of samples may show the same two of each top.
        long_enough = pairs >= max(4, 0.005 * samples.size) and triples >= 0.02 * pairs
        if long_enough and count > FLATTER * (below + 1):
            return count / samples.size
    return 0.0
