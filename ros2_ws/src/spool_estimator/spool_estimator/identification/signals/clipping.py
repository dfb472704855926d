"""Clipping of a channel: flat tops as no wave has them, and readings that pile up at a rail.

A flat top (:func:`flat_share`) shows within a second, behind noise, too; a rail (:func:`at_rail`) says which
samples of a whole record to leave out, be it a dozen.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]
Row = NDArray[np.floating[Any]]

#: Depths, as a share of half the span, of the strip at a channel's extremes that a flat top fills.
DEPTHS = (0.002, 0.02)

#: Times as long in that strip as in those below it that no wave spends there.
FLATTER = 6

#: Samples at a rail from which a channel clips, and how many times as many as at levels below it.
COUNT, PILED = 12, 10.0
#: Levels below: those of a sine read by a coarse converter are filled up to five times less than its top.
BELOW = 12


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


def at_rail(row: Array) -> NDArray[np.bool_] | None:
    """Return which samples sit at a rail: equal to the extreme, often, and in runs; ``None`` for none."""
    found = np.zeros(row.size, dtype=np.bool_)
    for side in (1.0, -1.0):
        values = side * row
        top = float(values.max())
        at_top = values >= top - 1e-6 * abs(top)
        count = int(np.count_nonzero(at_top))
        if top > 0.0 and count >= max(COUNT, PILED * _typical_count(values[~at_top])) and _in_runs(at_top):
            found |= at_top
    return found if found.any() else None


def _typical_count(values: Array) -> float:
    """Return how many of ``values`` share one of their highest levels."""
    some = values[values > np.quantile(values, 0.9)]
    _, counts = np.unique(some, return_counts=True)
    return float(counts[-BELOW:].mean()) if counts.size else 0.0


def _in_runs(pile: NDArray[np.bool_]) -> bool:
    pairs = pile[1:] & pile[:-1]
    return float(np.count_nonzero(pairs)) > 0.25 * float(np.count_nonzero(pile))


def restored(row: Array, gone: NDArray[np.bool_], rounds: int = 60) -> Array:
    """Return ``row`` with the samples ``gone`` filled by the band below a tenth of the sample rate.

    Papoulis and Gerchberg: the band-limited part of the whole replaces the gaps, again and again.
    """
    places = np.arange(row.size)
    filled = row.copy()
    filled[gone] = np.interp(places[gone], places[~gone], row[~gone])
    extreme = np.sign(row[gone]) * np.abs(row[gone])
    lines = row.size // 2 + 1
    keep = np.arange(lines) < 0.12 * lines
    for _ in range(rounds):
        spectrum = fft.rfft(filled)
        spectrum[~keep] = 0.0
        smooth = fft.irfft(spectrum, row.size)
        guess = smooth[gone]
        # Beyond the rail, on its side: that much is known.
        filled[gone] = np.where(extreme > 0.0, np.maximum(guess, extreme), np.minimum(guess, extreme))
    return filled
