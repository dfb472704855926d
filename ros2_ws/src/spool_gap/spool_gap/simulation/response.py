"""Response of the linear base: what small forces and sensor errors add to the spool's acceleration."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_estimator.identification.spectra import ZeroPhase, interval_mean_response

from .point import Point
from .segments import Stretch
from .simulate import Simulation

Array = NDArray[np.float64]


def responses(
    simulation: Simulation,
    point: Point,
    forces: Callable[[int], Array],
    slopes: Sequence[int] = (),
    chosen: Sequence[int] | None = None,
    readings: Callable[[int], Array] | None = None,
) -> list[Array]:
    """Return what each of several causes adds to the error of each window, m/s^2, shape (c, n) each.

    Args:
        simulation: the windows.
        point: gives mass, stiffness and damping.
        forces: forces that the model lacks along the motion of the stretch of a number, N, shape (c, n).
        slopes: orders of derivatives of the spool's reading, as columns after the forces: what an error of
            its sensor adds; scaled to the upper end of the excitation's band.
        chosen: numbers of the windows, all by default.
        readings: of the spool for the stretch of a number, m/s^2, shape (n,), that ``slopes`` are taken of;
            by default what of them stands out of white noise.
    """
    wanted = range(len(simulation.places)) if chosen is None else chosen
    found: dict[int, Array] = {}
    for number, stretch in enumerate(simulation.stretches):
        places = [place for place in wanted if simulation.places[place][0] is stretch]
        if not places:
            continue
        reading = stretch.quiet.apply(stretch.record.spool) if readings is None else readings(number)
        rows = _through(
            stretch,
            point.damped(simulation.damper),
            forces(number),
            (reading, slopes),
            means=simulation.jumps is None,
        )
        for place in places:
            window = simulation.places[place][1]
            part = slice(window.start, window.stop)
            mask = stretch.kept[part]
            if simulation.jumps is not None:
                mask = mask * simulation.jumps[place]
            found[place] = rows[:, part] * mask
    return [found[place] for place in wanted]


def _through(
    stretch: Stretch, point: Point, forces: Array, sensed_by: tuple[Array, Sequence[int]], *, means: bool
) -> Array:
    reading, slopes = sensed_by
    period = stretch.record.sample_period
    count = stretch.record.body.size
    reach = min(count - 1, round(1.0 / (stretch.low_cut * period)))
    length = fft.next_fast_len(count + 2 * reach, real=True)
    frequency = fft.rfftfreq(length, period)
    turn = 2j * np.pi * frequency
    values = point.values
    stiffness = values["mass"] * turn**2 + values["viscous_coefficient"] * turn + values["spring_stiffness"]
    band = ZeroPhase(period, stretch.low_cut, min(3.0 * stretch.noise.high, 0.4 / period))
    ends = interval_mean_response(frequency, period) if means else np.ones(frequency.size)
    passed = ends * turn**2 / stiffness
    rows = []
    for row in forces:
        rows.append(_filtered(row, passed, reach, length))
    if slopes:
        slope = turn / (2.0 * np.pi * stretch.noise.high)
        sensed = ends * band.gain(frequency)
        rows += [_filtered(reading, sensed * slope**order, reach, length) for order in slopes]
    return np.array(rows)


def _filtered(row: Array, response: NDArray[np.complex128], reach: int, length: int) -> Array:
    padded = np.pad(row, reach, mode="reflect", reflect_type="odd")
    return np.asarray(fft.irfft(fft.rfft(padded, length) * response, length)[reach : reach + row.size])
