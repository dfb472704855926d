"""Friction that differs by direction: two accelerometers see that only where the motion starts from rest.

To a moving spool the difference is a constant push, which shifts the middle of the motion but changes no
acceleration.
From rest the spool has to travel to that middle first, and rings there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.free_run import FreeRun, half_steps
from spool_sim.integration.composed_motion import MotionState
from spool_sim.model import Model
from spool_sim.valve import Valve

from .batches import simpson_means
from .point import Point
from .segments import Stretch
from .simulate import Simulation

Array = NDArray[np.float64]

PLAY = "spring_backlash"
#: s from the start that are looked at.
LOOKED_AT = 1.5
#: s over which the variance of what is left is taken: jumps of friction leave more where they are dense.
LOCAL = 0.1
#: Share of its mean, and of the channel's noise, that it is at least: samples that clip leave nothing.
LEAST_LOCAL, LEAST_VARIANCE = 0.2, 1e-2
#: s at the start in which the body must be quiet, and how quiet, over its rms later.
QUIET_TIME, QUIET_SHARE = 0.01, 0.03
#: Ratios (forward - backward) / (forward + backward) that are tried.
RATIOS = np.linspace(-0.9, 0.9, 37)
#: Shares of the play, within which the spool may rest anywhere, that are tried as its place.
PLACES = np.linspace(-1.0, 1.0, 9)


@dataclass(frozen=True, slots=True)
class Asymmetry:
    """What the start says.

    Attributes:
        ratio: (forward - backward) / (forward + backward).
        deviation: its standard deviation.
        evidence: twice the log likelihood ratio against equal forces.
        left: residual power over that of the noise at the best ratio.
    """

    ratio: float
    deviation: float
    evidence: float
    left: float


def starts_at_rest(stretch: Stretch) -> bool:
    """Whether the record begins before the motion does."""
    record = stretch.record
    count = max(4, round(QUIET_TIME * record.sample_rate))
    noise = 2.0 * stretch.noise.body_rms
    return record.first_sample == 0 and float(np.std(record.body[:count])) < max(
        QUIET_SHARE * float(record.body.std()), noise
    )


def asymmetry(
    simulation: Simulation, stretch: Stretch, point: Point, base: Model, valve: Valve
) -> Asymmetry | None:
    """Return what the start of ``stretch`` says about the friction of ``point``.

    ``None`` without a start from rest, or where no ratio of the forces explains it.

    Args:
        simulation: gives the kernels.
        stretch: with the record.
        point: a hypothesis with Coulomb friction.
        base: as analysed, for the window.
        valve: as described.
    """
    if not starts_at_rest(stretch):
        return None
    record = stretch.record
    period = record.sample_period
    size = round(LOOKED_AT / period)
    # In front of the record nothing moves: zeros there put the window's start on its first sample.
    lead = round(1.0 / (stretch.low_cut * period)) + round(0.5 / period) + 4
    quiet_body = stretch.quiet.apply(record.body)
    padded = replace(
        record.part(0, min(record.body.size, size + lead)),
        body=np.concatenate([np.zeros(lead), quiet_body[: size + lead]]),
        spool=np.concatenate([np.zeros(lead), record.spool[: size + lead]]),
        oil_temperature=None,
    )
    run = FreeRun([padded], base, valve, run_in=0.5, low_cut=stretch.low_cut)
    window = replace(run.windows[0], first=lead, start=lead, stop=lead + size)
    margin = run.windows[0].margin + lead - run.windows[0].first
    window = replace(window, margin=margin)
    mean = point.values["coulomb_force"]
    active = tuple("asymmetric_friction" if n == "coulomb_friction" else n for n in point.terms)
    motion = next(entry for entry in simulation.motions if entry.has(active))
    rows = np.array(
        [
            motion.row(
                active,
                {**point.values, "forward_force": (1.0 + r) * mean, "backward_force": (1.0 - r) * mean},
            )
            for r in RATIOS
        ]
    )
    substeps = 4
    excitation = half_steps(window, period, substeps, point.delay)
    excitation = excitation[: 2 * substeps * size + 1]
    rests = PLACES * point.values["backlash"] if PLAY in point.terms else np.zeros(1)
    trajectory, _ = motion.advance_batch(
        [MotionState(rest) for rest in rests.tolist() for _ in RATIOS],
        excitation[np.newaxis],
        np.tile(rows, (rests.size, 1))[:, np.newaxis, :],
        sample_period=period,
        substeps=substeps,
    )
    body = simpson_means(excitation, substeps)[:-1]
    means = (np.diff(trajectory.velocity, axis=1) / period + body) * (1.0 + point.gain)
    measured = 0.5 * (record.spool[: size - 1] + record.spool[1:size])
    kept = np.minimum(stretch.kept[: size - 1], stretch.kept[1:size])
    # Averages over 2 ms: slow against the jumps of friction, quick against the ring.
    width = max(1, round(0.002 / period))
    kernel = np.full(width, 1.0 / width)
    errors = np.array([np.convolve((row - measured) * kept, kernel, mode="valid")[::width] for row in means])
    errors = errors.reshape(rests.size, RATIOS.size, -1)
    least = np.unravel_index(int(np.argmin(np.sum(errors**2, axis=-1))), errors.shape[:2])
    # The harmonics of friction stand in the channel's noise: what is left says more.
    noise = stretch.noise.spool_rms**2 / width
    variance = _local(errors[least] ** 2, round(LOCAL / (width * period)), LEAST_VARIANCE * noise)
    sums = np.sum(errors**2 / variance, axis=-1).min(axis=0)
    place = int(np.argmin(sums))
    if place in (0, RATIOS.size - 1):
        return None
    near = np.flatnonzero(sums - sums[place] <= 4.0)
    step = float(RATIOS[1] - RATIOS[0])
    deviation = max(float(np.ptp(RATIOS[near])) / 4.0, step / 3.0)
    evidence = float(sums[RATIOS.size // 2] - sums[place])
    below, best, above = sums[place - 1 : place + 2].tolist()
    ratio = float(RATIOS[place]) + 0.5 * step * (below - above) / (below - 2.0 * best + above)
    return Asymmetry(ratio, deviation, evidence, float(variance.mean()) / noise)


def _local(squares: Array, count: int, least: float) -> Array:
    """Return the mean of ``squares`` (n,) over ``count`` of them around each, at least ``least``."""
    count = min(max(4, count), squares.size)
    mean = np.convolve(squares, np.full(count, 1.0 / count), mode="same")
    return np.asarray(np.maximum(mean, max(least, LEAST_LOCAL * float(squares.mean()))))
