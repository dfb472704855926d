"""Free runs of many points over many windows, in few calls of the kernel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_sim.composed_motion import MotionState
from spool_sim.step_size import substeps_for
from spool_sim.terms import term
from spool_stream.errors import InputError

from ..free_run import Window, half_steps
from .pieces import Piece
from .point import Point
from .stretches import Stretch
from .switchable import ALWAYS, SwitchableMotion

Array = NDArray[np.float64]
Job = tuple[Stretch, Window]

#: Most steps per sample that a hypothesis may ask for; a stiffer one is stepped more coarsely.
MOST_SUBSTEPS = 8
#: How much longer a step may be than the simulator's where no force has kinks, and how much longer still as
#: to the drive: a fit compares with noise, so an error of 1e-4 of the signal will do.
COARSER, SMOOTHER = 2.0, 1.7


@dataclass(frozen=True, slots=True)
class Run:
    """What one window gave for s points; arrays of shape (s, n).

    Attributes:
        acceleration: of the spool at the samples, m/s^2, gain error included.
        means: its mean from each sample to the next: exact and smooth in the parameters, whatever jumps.
        displacement, velocity: relative to the body, m, m/s.
    """

    acceleration: Array
    means: Array
    displacement: Array
    velocity: Array


class Batches:
    """Steps windows of one length together; keeps the drives of the last call, most of which come again."""

    def __init__(self) -> None:
        """Begin without drives."""
        self._drives: dict[tuple[int, float, int], tuple[Window, Array, Array]] = {}

    def run(self, motion: SwitchableMotion, points: Sequence[Point], jobs: Sequence[Job]) -> list[Run]:
        """Return what each of ``jobs`` gives for ``points`` (with the same terms), stepped by ``motion``."""
        rows = np.array([motion.row(point.active, point.values) for point in points])
        groups: dict[tuple[float, int, float, int], list[int]] = {}
        for number, (stretch, window) in enumerate(jobs):
            key = (
                stretch.record.sample_period,
                window.stop - window.first,
                stretch.highest_frequency,
                window.start - window.first,
            )
            groups.setdefault(key, []).append(number)
        found: dict[int, Run] = {}
        drives: dict[tuple[int, float, int], tuple[Window, Array, Array]] = {}
        for (period, _, highest, lead), numbers in groups.items():
            substeps = steps_a_sample(points[0], period, highest)
            own = [jobs[number][1] for number in numbers]
            begins = [stretch.record.first_sample for stretch, _ in (jobs[number] for number in numbers)]
            used: dict[tuple[int, float], int] = {}
            bodies: list[Array] = []
            means: list[Array] = []
            for place, window in enumerate(own):
                for delay in dict.fromkeys(point.delay for point in points):
                    key_ = (id(window), delay, substeps)
                    if key_ not in self._drives:
                        drive = half_steps(window, period, substeps, delay)
                        self._drives[key_] = window, drive, simpson_means(drive, substeps)
                    drives[key_] = self._drives[key_]
                    used[place, delay] = len(bodies)
                    bodies.append(drives[key_][1])
                    means.append(drives[key_][2][lead:-1])
            pairs = [(place, point) for place in range(len(own)) for point in points]
            states = [_start(own[place], point) for place, point in pairs]
            body_rows = [used[place, point.delay] for place, point in pairs]
            trajectory, _ = motion.advance_batch(
                [MotionState(z, v, float(np.sign(v))) for z, v in states],
                np.array(bodies),
                np.tile(rows, (len(own), 1))[:, np.newaxis, :],
                sample_period=period,
                substeps=substeps,
                first_sample=[begins[place] + own[place].first for place, _ in pairs],
                stands_on=body_rows,
            )
            gains = np.array([1.0 + point.gain for _, point in pairs])[:, np.newaxis]
            ahead = slice(lead, trajectory.velocity.shape[1] - 1)
            moved = np.diff(trajectory.velocity[:, lead:], axis=1) / period
            moved += np.array(means)[body_rows]
            moved *= gains
            acceleration = trajectory.acceleration[:, ahead] * gains
            for place, number in enumerate(numbers):
                part = slice(place * len(points), (place + 1) * len(points))
                found[number] = Run(
                    acceleration[part],
                    moved[part],
                    trajectory.displacement[part, ahead],
                    trajectory.velocity[part, ahead],
                )
        self._drives = drives
        return [found[number] for number in range(len(jobs))]


def steps_a_sample(point: Point, period: float, highest_frequency: float) -> int:
    """Return how many steps a sample (``period`` s) needs for the terms of ``point``."""
    # However steep a law of sliding is near rest, the reversal itself is located within the step.
    terms = [term(name) for name in dict.fromkeys((*ALWAYS, *point.active))]
    terms = [entry for entry in terms if "sliding_law" not in entry.laws or "force_law" in entry.laws]
    values = {p.name: p.start for entry in terms for p in entry.parameters} | dict(point.values)
    if not any("levels_law" in entry.laws for entry in terms):
        period, highest_frequency = period / COARSER, highest_frequency / SMOOTHER
    try:
        return min(substeps_for(terms, values, period, highest_frequency), MOST_SUBSTEPS)
    except InputError:
        return MOST_SUBSTEPS


def _start(window: Window, point: Point) -> tuple[float, float]:
    return window.state_at(point.gain, point.delay) if isinstance(window, Piece) else window.state


def simpson_means(drive: Array, substeps: int) -> Array:
    """Return the means over sample intervals of what the steps take as forcing, shape (n,).

    Args:
        drive: at the ends and midpoints of all steps, shape (2 n substeps + 1,).
        substeps: steps per sample.
    """
    steps = (drive[:-2:2] + 4.0 * drive[1:-1:2] + drive[2::2]) / 6.0
    return np.asarray(steps.reshape(-1, substeps).mean(axis=1))
