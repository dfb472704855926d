"""Free runs of many points over many windows, in few calls of the kernel."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_estimator.identification.free_run import Window, half_steps, half_steps_of
from spool_sim.integration.composed_motion import MotionState
from spool_sim.integration.step_size import substeps_for
from spool_sim.terms import term

from .point import Point
from .segments import Stretch
from .shooting import Piece
from .switchable import ALWAYS, SwitchableMotion

Array = NDArray[np.float64]
Job = tuple[Stretch, Window]
#: A window's identity, delay and gain of the spool's channel, steps a sample.
Place = tuple[int, float, float, int]

#: Most steps per sample that a hypothesis may ask for; a stiffer one is stepped more coarsely.
MOST_SUBSTEPS = 8
#: How much longer a step may be than the simulator's where no force has kinks, and how much longer still as
#: to the excitation: a fit compares with noise, so an error of 1e-4 of the signal will do.
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


@dataclass(frozen=True, slots=True)
class WindowExcitation:
    """Excitation of one window, at one delay and gain of the spool's channel.

    Attributes:
        window: kept, since excitations are known by its identity.
        steps: acceleration at the ends and midpoints of all steps, m/s^2, shape (2 n substeps + 1,).
        means: of the body's acceleration over sample intervals, m/s^2, shape (n,).
        pull: of the damper that ties it to the measured motion, over the mass, at the samples, m/s^2, in
            ``steps`` with the other sign; shape (n + 1,), or ``None`` without one.
    """

    window: Window
    steps: Array
    means: Array
    pull: Array | None


class Batches:
    """Steps windows of one length together; each thread keeps its last excitations: most come again."""

    def __init__(self) -> None:
        """Begin without excitations."""
        self._last = threading.local()

    def run(self, motion: SwitchableMotion, points: Sequence[Point], jobs: Sequence[Job]) -> list[Run]:
        """Return what each of ``jobs`` gives for ``points`` (with the same terms), stepped by ``motion``."""
        groups: dict[tuple[float, float, int, int], list[int]] = {}
        for number, (stretch, window) in enumerate(jobs):
            length, lead = window.stop - window.first, window.start - window.first
            key = stretch.record.sample_period, stretch.highest_frequency, length, lead
            groups.setdefault(key, []).append(number)
        found: dict[int, Run] = {}
        excitations: dict[Place, WindowExcitation] = {}
        last: dict[Place, WindowExcitation] = getattr(self._last, "excitations", {})
        for (period, highest, _, _), numbers in groups.items():
            substeps = steps_a_sample(points[0], period, highest)
            own = [jobs[number] for number in numbers]
            needed = {
                _place(window, point, substeps): (window, point) for _, window in own for point in points
            }
            known = {place: last[place] for place in needed if place in last}
            missing = {place: needed[place] for place in needed if place not in known}
            made = _excitations(list(missing.values()), period, substeps) if missing else []
            excitations.update(known)
            excitations.update(zip(missing, made, strict=True))
            found.update(zip(numbers, _together(motion, points, own, excitations, substeps), strict=True))
        self._last.excitations = excitations
        return [found[number] for number in range(len(jobs))]


def _place(window: Window, point: Point, substeps: int) -> Place:
    """Return by what the excitation of ``window`` at ``point`` is known."""
    synchronised = isinstance(window, Piece) and window.pull is not None
    return id(window), point.delay, point.gain if synchronised else 0.0, substeps


def _excitations(
    needed: Sequence[tuple[Window, Point]], period: float, substeps: int
) -> list[WindowExcitation]:
    """Return the excitation of each of ``needed``, windows of one length."""
    windows, delays = [window for window, _ in needed], [point.delay for _, point in needed]
    found = []
    steps = half_steps_of(windows, period, substeps, delays)
    for (window, point), row in zip(needed, steps, strict=True):
        means = simpson_means(row, substeps)
        if not isinstance(window, Piece) or window.pull is None:
            found.append(WindowExcitation(window, row, means, None))
            continue
        body, spool = (replace(window, excitation=spectrum) for spectrum in window.pull)
        pull = half_steps(spool, period, substeps) / (1.0 + point.gain)
        pull -= half_steps(body, period, substeps, point.delay)
        found.append(WindowExcitation(window, row - pull, means, pull[:: 2 * substeps]))
    return found


def _together(
    motion: SwitchableMotion,
    points: Sequence[Point],
    jobs: Sequence[Job],
    excitations: Mapping[Place, WindowExcitation],
    substeps: int,
) -> list[Run]:
    """Return what each of ``jobs``, windows of one length, gives for ``points``."""
    stretch, window = jobs[0]
    period, lead = stretch.record.sample_period, window.start - window.first
    pairs = [(job, point) for job in jobs for point in points]
    places = [_place(window, point, substeps) for (_, window), point in pairs]
    rows = {place: row for row, place in enumerate(dict.fromkeys(places))}
    stands_on = [rows[place] for place in places]
    sets = np.array([motion.row(point.terms, point.values) for point in points])
    states = [_start(window, point) for (_, window), point in pairs]
    trajectory, _ = motion.advance_batch(
        [MotionState(z, v, float(np.sign(v))) for z, v in states],
        np.array([excitations[place].steps for place in rows]),
        np.tile(sets, (len(jobs), 1))[:, np.newaxis, :],
        sample_period=period,
        substeps=substeps,
        first_sample=[stretch.record.first_sample + window.first for (stretch, window), _ in pairs],
        stands_on=stands_on,
    )
    gains = np.array([1.0 + point.gain for _, point in pairs])[:, np.newaxis]
    distorted = any(point.sensors for point in points)
    first = 0 if distorted else lead
    ahead, counted = slice(first, trajectory.velocity.shape[1] - 1), slice(lead - first, None)
    means = np.diff(trajectory.velocity[:, first:], axis=1) / period
    means += np.array([excitations[place].means[first:-1] for place in rows])[stands_on]
    acceleration = trajectory.acceleration[:, ahead]
    if excitations[places[0]].pull is not None:
        acceleration = acceleration + np.array([excitations[place].pull for place in rows])[stands_on, ahead]
    if distorted:
        begins = np.array([(s.record.first_sample + w.first + first) * period for (s, w), _ in pairs])
        acceleration, means = (_read(rows_, points, period, begins) for rows_ in (acceleration, means))
    whole = (
        acceleration[:, counted] * gains,
        means[:, counted] * gains,
        trajectory.displacement[:, ahead][:, counted],
        trajectory.velocity[:, ahead][:, counted],
    )
    parts = [slice(first, first + len(points)) for first in range(0, len(pairs), len(points))]
    return [Run(*(array[part] for array in whole)) for part in parts]


def _read(accelerations: Array, points: Sequence[Point], period: float, begins: Array) -> Array:
    """Return what the spool's channel reads by the sensor effects of ``points``, whose rows take turns.

    ``begins`` are the times of the rows' first samples, s, shape (rows,).
    """
    read = accelerations.copy()
    time = begins[:, np.newaxis] + period * np.arange(read.shape[1])
    for number, point in enumerate(points):
        own = slice(number, None, len(points))
        for sensor in point.sensors:
            read[own] = sensor.reading(read[own], period, point.values, time[own])
    return read


def steps_a_sample(point: Point, period: float, highest_frequency: float) -> int:
    """Return how many steps a sample (``period`` s) needs for the terms of ``point``."""
    # However steep a law of sliding is near rest, the reversal itself is located within the step.
    terms = [term(name) for name in dict.fromkeys((*ALWAYS, *point.terms))]
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


def simpson_means(excitation: Array, substeps: int) -> Array:
    """Return the means over sample intervals of what the steps take as forcing, shape (n,).

    Args:
        excitation: at the ends and midpoints of all steps, shape (2 n substeps + 1,).
        substeps: steps per sample.
    """
    steps = (excitation[:-2:2] + 4.0 * excitation[1:-1:2] + excitation[2::2]) / 6.0
    return np.asarray(steps.reshape(-1, substeps).mean(axis=1))
