"""Free run of position: the motion of a driven mass from its measured force alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.integration.step_size import substeps_for
from spool_sim.model import Model
from spool_sim.terms import term

from .force_balance import white_power
from .force_record import ForceRecord

Array = NDArray[np.float64]

#: Error of the velocity that a run starts with, over the velocity's rms: what it adds to the displacement is
#: that share of a time constant's way.
SPEED_ERROR = 2e-3
#: Steps a sample at least: the force between samples is taken as linear.
FEWEST = 2


def position_run(
    record: ForceRecord, start: tuple[float, float], model: Model, zero: float, sign: float = 1.0
) -> Array:
    """Return the displacement, m, shape (n,), that ``model`` gives for the force of ``record``.

    The run starts from the measured displacement and velocity and sees the force alone from there on.

    Args:
        record: displacement and force, shape (n,).
        start: displacement from the middle of the springs, m, and velocity, m/s, at its first sample.
        model: with the mass among its values.
        zero: of the load cell, or a constant force, N, in the direction of the velocity.
        sign: -1 where the rig counts the force against the velocity.

    Raises:
        InputError: the model is too stiff for the record's rate.
    """
    values = dict(model.values)
    mass = values["mass"]
    substeps = max(FEWEST, substeps_for(model.terms, values, record.period))
    places = np.arange(2 * record.force.size * substeps + 1) / (2.0 * substeps)
    pushed = -(sign * record.force - zero) / mass
    steps = np.interp(places, np.arange(record.force.size), pushed)
    kernel = _kernel(tuple(entry.name for entry in model.terms))
    table = kernel.table(values, record.force.size)
    place, speed = start
    state = MotionState(place, speed, float(np.sign(speed)))
    trajectory, _ = kernel.advance(state, steps, table, sample_period=record.period, substeps=substeps)
    return np.asarray(trajectory.displacement + (record.displacement[0] - place))


def speed_at(record: ForceRecord, place: int) -> float:
    """Return the velocity at the sample ``place`` of ``record``, m/s: the slope of a parabola around it.

    Over as few samples as the displacement's noise allows: from rest the motion begins within some.
    """
    rms = float(np.std(np.diff(record.displacement))) / record.period
    noise = math.sqrt(white_power(record.displacement))
    # The variance of the slope at the end of n samples of a parabola is 192 sigma^2 / (n^3 period^2).
    wanted = (192.0 * (noise / (SPEED_ERROR * max(rms, 1e-12) * record.period)) ** 2) ** (1.0 / 3.0)
    half = int(np.clip(math.ceil(0.5 * wanted), 2, max(2, record.force.size // 20)))
    low, high = max(0, place - half), min(record.force.size, place + half + 1)
    time = (np.arange(low, high) - place) * record.period
    return float(np.polyfit(time, record.displacement[low:high], 2)[1])


@lru_cache(maxsize=16)
def _kernel(names: tuple[str, ...]) -> ComposedMotion:
    """Return the kernel of the terms called ``names``, loaded once."""
    return ComposedMotion([term(name) for name in names])


def position_rmse(
    records: Sequence[ForceRecord], model: Model, zero: float, centre: float, sign: float = 1.0
) -> float:
    """Return rms(model - measured) of free runs over ``records``, m; NaN where the model cannot be run.

    ``centre`` is the middle of the springs, m.
    """
    squares = count = 0.0
    for record in records:
        start = float(record.displacement[0]) - centre, speed_at(record, 0)
        try:
            error = position_run(record, start, model, zero, sign)
        except InputError:
            return math.nan
        error = error - record.displacement
        squares += float(np.sum(error**2))
        count += error.size
    return math.sqrt(squares / count) if np.isfinite(squares) else math.nan
