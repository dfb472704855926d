"""Simulating dry friction: ours beside SciPy's solvers on the same problem, and many valves at once."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from spool_sim.composed_motion import ComposedMotion, MotionState
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.motion import half_step_times

from .timing import Timing, best_of

Array = NDArray[np.float64]

SECONDS, RATE = 10.0, 2000.0
MASS, DRAG, STIFFNESS, FRICTION = 0.18, 2.65, 1632.0, 0.5
AMPLITUDE, LOW, HIGH = 10.0, 8.0, 110.0
VALUES = {
    "mass": MASS,
    "spring_stiffness": STIFFNESS,
    "viscous_coefficient": DRAG,
    "coulomb_force": FRICTION,
}
#: s that a solver may take; one that needs more has given up, and its row holds this time and no error. One
#: that stops with a failure is set going again from its last sample with half the largest step, until then.
CAP = 6.0
METHODS = ("LSODA", "Radau", "RK45", "BDF")
TOLERANCES = (1e-3, 1e-6, 1e-9)
BATCHES = (1, 64, 1024)


@dataclass(frozen=True, slots=True)
class Friction:
    """How a solver without sets is given dry friction."""

    name: str
    sign: Callable[[float], float]


FRICTIONS = (
    Friction("sgn", lambda v: math.copysign(1.0, v) if v else 0.0),
    Friction("tanh(v/1e-4)", lambda v: math.tanh(v / 1e-4)),
)


class _GaveUpError(Exception):
    """The time allowed is over."""


def run() -> Iterator[Timing]:
    """Yield one row per solver, friction and tolerance, then one per number of valves."""
    motion = ComposedMotion(MODELS["coulomb"].terms)
    sweep = SweptSine(
        start_frequency=LOW, stop_frequency=HIGH, duration=SECONDS, amplitude=AMPLITUDE, soft_start=0.0
    )
    reference = _ours(motion, sweep, 128)
    runs = []
    for substeps in (1, 2, 4, 8):
        forcing = sweep.acceleration(half_step_times(0, round(SECONDS * RATE), RATE, substeps))
        taken = best_of(7, lambda forcing=forcing, n=substeps: _step(motion, forcing, n))
        runs.append((taken, _error(_ours(motion, sweep, substeps), reference)))
    for method in METHODS:
        for friction in FRICTIONS:
            for tolerance in TOLERANCES:
                work = f"{SECONDS:g} s of sweep with Coulomb friction, rtol {tolerance:g}"
                peer = f"solve_ivp {method}, {friction.name}"
                seconds, motion_found = _scipy(method, friction, tolerance)
                if motion_found is None:
                    peer = f"{peer}: no result in {seconds:.0f} s"
                error = None if motion_found is None else _error(motion_found, reference)
                # The fastest of ours that is no worse; a solver that gave up is held against our most exact.
                fit = [run for run in runs if error is not None and run[1] <= error] or runs[-1:]
                ours, ours_error = min(fit)
                yield Timing(work, peer, ours, seconds, ours_error, error)
    yield from _batches(motion, sweep)


def _step(motion: ComposedMotion, forcing: Array, substeps: int) -> Array:
    trajectory, _ = motion.advance(
        MotionState(), forcing, motion.table(VALUES, 1), sample_period=1.0 / RATE, substeps=substeps
    )
    return trajectory.displacement


def _ours(motion: ComposedMotion, sweep: SweptSine, substeps: int) -> Array:
    times = half_step_times(0, round(SECONDS * RATE), RATE, substeps)
    return _step(motion, sweep.acceleration(times), substeps)


def _error(found: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((found - reference) ** 2) / np.mean(reference**2)))


def _scipy(method: str, friction: Friction, tolerance: float) -> tuple[float, Array | None]:
    """Return the time taken (s) and the displacement at the samples, or ``None`` where it gave up."""
    begin = time.perf_counter()
    rate = (HIGH - LOW) / SECONDS
    calls = 0

    def slope(t: float, y: Array) -> tuple[float, float]:
        nonlocal calls
        calls += 1
        if calls % 256 == 0 and time.perf_counter() - begin > CAP:
            raise _GaveUpError
        z, v = float(y[0]), float(y[1])
        body = AMPLITUDE * math.sin(2.0 * math.pi * (LOW + 0.5 * rate * t) * t)
        return v, -body - (DRAG * v + STIFFNESS * z + FRICTION * friction.sign(v)) / MASS

    times = np.arange(round(SECONDS * RATE)) / RATE
    found = np.zeros((times.size, 2))
    first, largest_step = 0, 0.25 / HIGH
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # LSODA warns at each failure; the row says so
        while first < times.size:
            try:
                part = solve_ivp(
                    slope,
                    (times[first], SECONDS),
                    found[first],
                    method=method,
                    t_eval=times[first:],
                    rtol=tolerance,
                    atol=1e-6 * tolerance,
                    max_step=largest_step,
                )
            except _GaveUpError:
                return time.perf_counter() - begin, None
            found[first : first + part.t.size] = part.y.T
            if part.success:
                break
            first += max(0, part.t.size - 1)
            largest_step = max(1e-6, 0.5 * largest_step)
    return time.perf_counter() - begin, found[:, 0]


def _batches(motion: ComposedMotion, sweep: SweptSine) -> Iterator[Timing]:
    """Yield the time of 1 s for n valves beside n times the time of one valve."""
    samples = round(RATE)
    forcing = sweep.acceleration(half_step_times(0, samples, RATE, 2))[np.newaxis]
    table = motion.table(VALUES, 1)
    one = 0.0
    for count in BATCHES:
        tables = np.repeat(table[np.newaxis], count, axis=0)
        tables[:, :, -1] *= np.linspace(1.0, 1.5, count)[:, np.newaxis]
        states = [MotionState()] * count

        def advance(states: list[MotionState] = states, tables: Array = tables) -> object:
            return motion.advance_batch(states, forcing, tables, sample_period=1.0 / RATE, substeps=2)

        taken = best_of(20 if count == 1 else 3, advance)
        one = one or taken
        yield Timing(f"1 s of {count} valves together", f"{count} times one valve", taken, count * one)
