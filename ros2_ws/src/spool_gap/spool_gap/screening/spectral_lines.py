"""Spectral lines of the residual that the excitation does not have: a periodic force from outside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from spool_gap.simulation.segments import Stretch
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

#: Lines at most.
MOST = 4


def lines_beside_excitation(stretches: Sequence[Stretch], values: Mapping[str, float]) -> tuple[float, ...]:
    """Return frequencies (Hz), strongest first, at which the balance of forces has a line, the body none."""
    stretch = max(stretches, key=lambda entry: entry.record.body.size)
    record, motion = stretch.record, stretch.motion
    force = (
        values["mass"] * motion.spool
        + values["viscous_coefficient"] * motion.velocity
        + values["spring_stiffness"] * motion.displacement
    )
    window = np.hanning(force.size)
    residual = np.abs(np.fft.rfft(force * window))
    body = np.abs(np.fft.rfft(record.body * window))
    frequency: Array = np.asarray(np.fft.rfftfreq(force.size, record.sample_period), dtype=np.float64)
    inside = (frequency > 2.0 * stretch.low_cut) & (frequency < 0.45 / record.sample_period)
    prominence = residual / _neighbourhood(residual)
    driven = body / _neighbourhood(body) > np.maximum(THRESHOLDS.line_of_noise, 0.3 * prominence)
    prominence[(~inside) | driven] = 0.0
    found: list[float] = []
    for place in np.argsort(prominence)[::-1][:40].tolist():
        if prominence[place] < THRESHOLDS.line or len(found) >= MOST:
            break
        if all(abs(frequency[place] - other) > 5.0 / record.duration for other in found):
            found.append(_refined(frequency, residual, place))
    return tuple(found)


def _neighbourhood(lines: Array) -> Array:
    """Return the median of some 200 lines around each, from medians of pieces."""
    width = max(8, min(200, lines.size // 8))
    count = lines.size // width
    pieces = np.median(lines[: count * width].reshape(count, width), axis=1)
    centres = (np.arange(count) + 0.5) * width
    return np.asarray(np.maximum(np.interp(np.arange(lines.size), centres, pieces), 1e-30))


def _refined(frequency: Array, lines: Array, place: int) -> float:
    """Return the frequency of a line between those of the transform, for a Hann window."""
    if not 0 < place < lines.size - 1:
        return float(frequency[place])
    left, middle, right = np.log(np.maximum(lines[place - 1 : place + 2], 1e-30)).tolist()
    curve = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curve if curve < 0.0 else 0.0
    return float(frequency[place] + shift * (frequency[1] - frequency[0]))
