"""Resampling: values of an equidistant series between its samples, by a windowed sinc."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .sample_clock import Array

#: Samples on both sides together, and the shape of the Kaiser window for 80 dB: 0.1102 (80 - 8.7). The gain
#: is then within 1e-4 up to 0.42 of the sample rate (Oppenheim and Schafer, Discrete-Time Signal Processing,
#: 3rd edition, section 7.5.3).
TAPS, SHAPE = 32, 0.1102 * (80.0 - 8.7)

#: Share of a period up to which a time is that of the sample itself: the phase error at the highest frequency
#: is 3e-4, as small as the filter's own; two sensors sampled together are passed on as they are.
ON_SAMPLE = 1.0e-4


def margin(ratio: float = 1.0) -> int:
    """Return the samples that are needed on each side; ``ratio``: the series' rate over the result's."""
    return int(np.ceil(TAPS / 2 * max(1.0, ratio)))


def on_samples(places: Array) -> bool:
    """Return whether all ``places`` (sample numbers as real numbers) are those of samples."""
    return bool((np.abs(places - np.rint(places)) <= ON_SAMPLE).all())


def resampled(values: Callable[[NDArray[np.int64]], Array], places: Array, ratio: float = 1.0) -> Array:
    """Return the series at ``places``, shape (n,); NaN where a sample that is needed is missing.

    Args:
        values: gives the series' samples by number.
        places: sample numbers as real numbers, shape (n,).
        ratio: the series' rate over that of the result; above 1 the series is limited to half of the result's
            rate first, with a transition from 0.42 to 0.58 of it.

    """
    if ratio <= 1.01 and on_samples(places):
        return values(np.rint(places).astype(np.int64))
    cut = min(1.0, 1.0 / ratio)
    half = margin(ratio)
    base = np.floor(places).astype(np.int64)
    offsets = np.arange(1 - half, half + 1)
    distances = offsets - (places - base)[:, None]
    inside = np.clip(1.0 - (distances / half) ** 2, 0.0, None)
    weights = np.sinc(cut * distances) * np.i0(SHAPE * np.sqrt(inside))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.asarray((weights * values(base[:, None] + offsets)).sum(axis=1), dtype=np.float64)
