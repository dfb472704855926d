"""Force loops: force over displacement and velocity at the measured motion, and what a model lacks there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.free_run import excitation_limit
from spool_estimator.identification.record import Record, first_seconds
from spool_estimator.identification.signals.zero_phase import ZeroPhase, delayed, relative_motion
from spool_sim.integration.composed_motion import ComposedMotion

from .runs import LONGEST, LOW_CUT, Numbers, of_one_rate

Array = NDArray[np.float64]

#: Periods of the loop that is drawn, bins of displacement and velocity, and samples in a bin at least.
PERIODS, BINS, LEAST = 3.0, 25, 12


@dataclass(frozen=True, slots=True)
class Profile:
    """Median of a force over a quantity: ``centres`` of its bins, and ``force`` (N) there, shape (b,)."""

    centres: Array
    force: Array


@dataclass(frozen=True, slots=True)
class Loops:
    """Forces at the measured motion.

    Attributes:
        displacement, velocity: of the excerpt, m and m/s, shape (n,).
        measured: force that springs, oil and friction took there, N, shape (n,).
        models: what each model says of it, N, shape (n,), by name.
        over_displacement, over_velocity: median of the missing force over the whole record, by name.
        missing: rms of the missing force over the whole record, N, by name.
        force: rms of the measured force over the whole record, N.
        start: s, of the excerpt.
    """

    displacement: Array
    velocity: Array
    measured: Array
    models: Mapping[str, Array]
    over_displacement: Mapping[str, Profile]
    over_velocity: Mapping[str, Profile]
    missing: Mapping[str, float]
    force: float
    start: float


def loops_of(records: Sequence[Record], sides: Sequence[Numbers]) -> Loops:
    """Return the forces of ``sides`` beside the measured one, at the motion of both accelerometers.

    Measured: - m a of the spool. All rows passed the same filter, so that like is compared with like. The
    channel is that of the last of ``sides``, whose gain and delay are taken out.

    Raises:
        InputError: the records are too short, or the spool does not move.
    """
    rows = of_one_rate(records)
    last = sides[-1]
    mass = last.values.get("mass", np.nan)
    if not mass > 0.0:
        raise InputError("the model has no mass, so accelerations say nothing of forces")
    motions = {side.name: ComposedMotion(side.model.terms) for side in sides}
    parts: list[tuple[float, Array, Array, Array, dict[str, Array]]] = []
    period = rows[0].sample_period
    for number, some in first_seconds(rows, LONGEST, shortest=6.0 / LOW_CUT):
        both = ZeroPhase(period, LOW_CUT, 1.5 * max(excitation_limit(rows[number]), 30.0))
        spool = (delayed(some.spool, -last.delay, period) if last.delay else some.spool) / (1.0 + last.gain)
        motion = relative_motion(some.body, spool, ZeroPhase(period, LOW_CUT))
        inside = slice(2 * both.settling, some.body.size - 2 * both.settling)
        models = {}
        for side in sides:
            table = np.array([[float(side.values[name]) for name in motions[side.name].names]])
            force = motions[side.name].forces(
                motion.displacement, motion.velocity, table, sample_period=period,
                first_sample=some.first_sample,
            )[0]  # fmt: skip
            models[side.name] = both.apply(force)[inside]
        begin = (some.start - rows[0].start) * 1e-9 + inside.start * period
        measured = (-mass * both.apply(motion.spool))[inside]
        parts.append((begin, motion.displacement[inside], motion.velocity[inside], measured, models))
    if not parts:
        raise InputError("no stretch is long enough for the motion of both accelerometers to settle")
    return loops_from(parts, period)


def loops_from(
    parts: Sequence[tuple[float, Array, Array, Array, Mapping[str, Array]]], period: float
) -> Loops:
    """Return the loops of ``parts``: start (s), displacement, velocity, measured force and the models'.

    Raises:
        InputError: nothing moves.
    """
    z, v, measured = (np.concatenate([part[place] for part in parts]) for place in (1, 2, 3))
    models = {name: np.concatenate([part[4][name] for part in parts]) for name in parts[0][4]}
    if not (float(np.ptp(z)) > 0.0 and float(np.ptp(v)) > 0.0):
        raise InputError("the spool does not move in its body")
    begin, first, stop, number = _excerpt(parts, period)
    chosen = parts[number]
    excerpt = slice(first, stop)
    missing = {name: measured - force for name, force in models.items()}
    return Loops(
        chosen[1][excerpt],
        chosen[2][excerpt],
        chosen[3][excerpt],
        {name: row[excerpt] for name, row in chosen[4].items()},
        {name: _profile(z, row) for name, row in missing.items()},
        {name: _profile(v, row) for name, row in missing.items()},
        {name: float(np.sqrt(np.mean(row**2))) for name, row in missing.items()},
        float(np.sqrt(np.mean(measured**2))),
        begin + first * period,
    )


def _excerpt(
    parts: Sequence[tuple[float, Array, Array, Array, Mapping[str, Array]]], period: float
) -> tuple[float, int, int, int]:
    """Return start (s), first and last sample and number of the part with the largest motion."""
    sizes = [float(np.abs(part[1]).max()) for part in parts]
    number = int(np.argmax(sizes))
    begin, z, v = parts[number][0], parts[number][1], parts[number][2]
    # A sine of amplitude Z has velocity 2 pi f Z: what the motion repeats at, about.
    near = slice(*_around(int(np.argmax(np.abs(z))), round(0.5 / period), z.size))
    rms = [float(np.sqrt(np.mean(row[near] ** 2))) for row in (z, v)]
    frequency = max(rms[1] / max(2.0 * np.pi * rms[0], 1e-12), 1.0)
    first, stop = _around(int(np.argmax(np.abs(z))), round(PERIODS / frequency / period), z.size)
    return begin, first, stop, number


def _around(centre: int, length: int, size: int) -> tuple[int, int]:
    length = min(size, max(16, length))
    first = min(max(0, centre - length // 2), size - length)
    return first, first + length


def _profile(over: Array, force: Array) -> Profile:
    reach = float(np.quantile(np.abs(over), 0.998))
    edges = np.linspace(-reach, reach, BINS + 1)
    place = np.digitize(over, edges) - 1
    rows = [
        (0.5 * (edges[number] + edges[number + 1]), float(np.median(force[place == number])))
        for number in range(BINS)
        if np.count_nonzero(place == number) >= LEAST
    ]
    table = np.array(rows).reshape(-1, 2)
    return Profile(table[:, 0], table[:, 1])
