"""Delay that remains between two clocks once the spool's dry friction is told from it.

Cross-spectra know a linear spool alone; friction moves their phase by some tenths of a millisecond. The
suite's own fit of springs, viscous and dry friction tells the delay beside them. Of a spool the mass scales
forces and nothing else, so that none needs to be known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import SPOOL_DELAY, FitSettings
from spool_estimator.identification.record import Record
from spool_sim.model import load_model
from spool_sim.valve.description import Valve

#: s of the pieces in which the delay is fitted, and how many, spread evenly: the line through four has two
#: degrees of freedom left, by which its own scatter is known.
PIECE, PIECES = 15.0, 4
#: kg, of any spool: it scales forces alone.
MASS = 0.2
#: s: beyond the fit's own range the delay was not found.
LARGEST = 4.9e-3

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Remaining:
    """Remaining delay of the spool: ``offset`` (s) at time 0, ``drift``, and standard deviations."""

    offset: float
    offset_std: float
    drift: float
    drift_std: float


def remaining_delay(
    time: Array, body: Array, spool: Array, period: float, gaps: Sequence[int], natural_frequency: float
) -> Remaining | None:
    """Return what is left of offset and drift of samples that were aligned already, shape (n,) each.

    ``natural_frequency`` (Hz) of the spool, about. ``None`` where fewer than two pieces can be fitted.
    """
    model, settings = load_model("coulomb"), FitSettings(fit_delay=True, noise_seconds=0.0, starts=1)
    stiffness = MASS * (2.0 * math.pi * natural_frequency) ** 2
    valve = Valve(id="any", moving_mass=MASS, spring_stiffness=stiffness)
    times, delays, deviations = [], [], []
    for begin, end in _pieces(time.size, period, gaps):
        record = Record("aligned", 0, period, body[begin:end], spool[begin:end])
        found = fit([record], model, valve, settings)
        delay = next((one for one in found.parameters if one.name == SPOOL_DELAY), None)
        if (
            delay is None
            or not math.isfinite(delay.value + delay.standard_deviation)
            or abs(delay.value) > LARGEST
        ):
            continue
        times.append(float(time[begin:end].mean()))
        delays.append(delay.value)
        deviations.append(max(delay.standard_deviation, 1e-6))
    return _line(np.array(times), np.array(delays), np.array(deviations))


def _pieces(size: int, period: float, gaps: Sequence[int]) -> list[tuple[int, int]]:
    """Return up to :data:`PIECES` stretches without gaps, spread evenly."""
    width = min(round(PIECE / period), size // PIECES)
    if width * period < 0.5 * PIECE:
        return []
    starts = np.linspace(0, size - width, PIECES).astype(np.int64)
    inside = [
        (int(start), int(start) + width)
        for start in starts
        if not any(start < gap < start + width for gap in gaps)
    ]
    return list(dict.fromkeys(inside))


def _line(times: Array, delays: Array, deviations: Array) -> Remaining | None:
    """Return the weighted line through the delays; its scatter, where larger, stands for their deviations."""
    if times.size < 2:
        return None
    design = np.column_stack([np.ones_like(times), times]) / deviations[:, np.newaxis]
    covariance = np.linalg.inv(design.T @ design)
    found = covariance @ (design.T @ (delays / deviations))
    left = delays / deviations - design @ found
    scatter = float(left @ left) / (times.size - 2) if times.size > 2 else 1.0
    stds = np.sqrt(np.diag(covariance) * max(1.0, scatter))
    return Remaining(float(found[0]), float(stds[0]), float(found[1]), float(stds[1]))
