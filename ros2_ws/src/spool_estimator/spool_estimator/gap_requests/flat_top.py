"""Whether a channel clips: its tops are flat as those of no wave are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_stream.kernels.compiled import compiled

Row = NDArray[np.floating[Any]]

#: Depths, as a share of half the span, of the strip at a channel's extremes that a flat top fills.
DEPTHS = (0.002, 0.02)

#: Times as long in that strip as in those below it that no wave spends there.
FLATTER = 6


def flat_share(samples: Row) -> float:
    """Return the share of ``samples``, shape (n,), on a flat top at the upper or lower extreme."""
    low, high = float(samples.min()), float(samples.max())
    half = 0.5 * (high - low)
    return flat_top(samples, high, half) + flat_top(samples, low, -half) if half > 0.0 else 0.0


@compiled
def flat_top(samples: Row, peak: float, half: float) -> float:
    """Return the share of ``samples`` on a flat top at ``peak``, 0 for the top of any wave.

    ``half`` of the span is positive at the upper extreme and negative at the lower one.

    A sine spends as long within a depth below its peak as in the strip from there to four times that depth,
    the flattest sum of two waves (a top with two humps) 4.4 times as long; a clipped one spends much more,
    and neighbours of each sample in the strip lie in it too.
    """
    side = math.copysign(1.0, half)
    for depth in DEPTHS:
        top, strip = side * (peak - depth * half), side * (peak - 4.0 * depth * half)
        count = pairs = triples = below = run = 0
        for sample in samples:
            value = side * float(sample)
            if value < strip:
                run = 0
            elif value < top:
                run = 0
                below += 1
            else:
                run += 1
                count += 1
                pairs += run > 1
                triples += run > 2
        # A wave whose period is a whole number of samples may show the same two of each top.
        long_enough = pairs >= max(4.0, 0.005 * samples.size) and triples >= 0.02 * pairs
        if long_enough and count > FLATTER * (below + 1):
            return count / samples.size
    return 0.0
