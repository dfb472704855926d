"""Benchmark of simulating dry friction, against SciPy's solvers and compiled schemes; many valves together.

Times are processor time; ours holds the computing of the excitation, as the peers' does. A ratio is the
product of two factors: how much longer the peer took than it would need were it compiled (its evaluations of
the equation of motion, each at the time that one takes in a compiled scheme of :mod:`.sim_compiled`), and
what is left for the scheme. Work of the solver besides the evaluations counts as interpreted: of implicit
ones the first factor is too large.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.integration.step_size import half_step_times
from spool_sim.model import MODELS

from spool_evaluation.results.timing import Timing, best_of

from . import sim_compiled, sim_peer
from .sim_peer import (
    AMPLITUDE,
    DRAG,
    EVENTS,
    FRICTION,
    HIGH,
    LOW,
    MASS,
    RATE,
    SECONDS,
    SIGNS,
    STIFFNESS,
    Solved,
)

Array = NDArray[np.float64]

VALUES = {
    "mass": MASS,
    "spring_stiffness": STIFFNESS,
    "viscous_coefficient": DRAG,
    "coulomb_force": FRICTION,
}
PLANT, SWEEP = (MASS, DRAG, STIFFNESS, FRICTION), (AMPLITUDE, LOW, (HIGH - LOW) / SECONDS)
WORK = f"{SECONDS:g} s of sweep with Coulomb friction"
#: s that a solver may take; one that needs more has given up, and its row holds this time and no error.
CAP = 6.0
METHODS = ("LSODA", "Radau", "RK45", "BDF")
TOLERANCES = (1e-3, 1e-6, 1e-9)
#: Of order 5 and 8, with rest and break-away as events.
EVENT_METHODS = ("RK45", "DOP853")
#: Steps per sample of the compiled schemes: from where they are of use to where they are slower than ours.
MOREAU_STEPS, LOCATED_STEPS = (4, 16, 64, 256), (1, 2, 4)
#: Steps per sample and width of the tanh, m/s: the largest steps that are stable.
SMOOTHED = ((8, 1e-3), (32, 1e-4), (300, 1e-5))
BATCHES = (1, 64, 1024)


@dataclass(frozen=True, slots=True)
class TimedRun:
    """Timed run of ours: s for excitation and motion together, and the error against the reference."""

    seconds: float
    error: float


@dataclass(frozen=True, slots=True)
class Ours:
    """Reference runs: ours, and what they are held against.

    Attributes:
        runs: with 1, 2, 4 and 8 steps per sample.
        reference: displacement at the samples with 128, m, shape (n,).
    """

    runs: Sequence[TimedRun]
    reference: Array

    def comparable(self, error: float | None) -> TimedRun:
        """Return the fastest that is no worse; the most exact for a solver that gave up."""
        fit = [run for run in self.runs if error is not None and run.error <= error]
        return min(fit, key=lambda run: run.seconds) if fit else self.runs[-1]


def run() -> Iterator[Timing]:
    """Yield the rows of the compiled schemes, of SciPy's solvers, and one per number of valves."""
    motion = ComposedMotion(MODELS["coulomb"].terms)
    sweep = SweptSine(
        start_frequency=LOW, stop_frequency=HIGH, duration=SECONDS, amplitude=AMPLITUDE, soft_start=0.0
    )
    ours = measured(motion, sweep)
    yield from compiled_rows(ours)
    evaluation = evaluation_time()
    for method in METHODS:
        for friction in SIGNS:
            for tolerance in TOLERANCES:
                yield scipy_row(ours, method, friction, tolerance, evaluation)
    for method in EVENT_METHODS:
        for tolerance in TOLERANCES:
            yield scipy_row(ours, method, EVENTS, tolerance, evaluation)
    yield from _batches(motion, sweep)


def measured(motion: ComposedMotion, sweep: SweptSine) -> Ours:
    """Return our runs, each with its excitation, and the reference."""
    reference = _ours(motion, sweep, 128)
    runs = [
        TimedRun(
            best_of(7, partial(_ours, motion, sweep, steps), process_time),
            _error(_ours(motion, sweep, steps), reference),
        )
        for steps in (1, 2, 4, 8)
    ]
    return Ours(runs, reference)


def compiled_rows(ours: Ours) -> Iterator[Timing]:
    """Yield a row per compiled scheme and step."""
    samples, period = round(SECONDS * RATE), 1.0 / RATE
    peers: list[tuple[str, Callable[[], tuple[Array, int]]]] = []
    for steps in MOREAU_STEPS:
        moreau = partial(sim_compiled.moreau, samples, period, steps, PLANT, SWEEP)
        peers.append((f"compiled Moreau midpoint, {steps} steps a sample", moreau))
    for steps, width in SMOOTHED:
        smoothed = partial(sim_compiled.smoothed, samples, period, steps, PLANT, SWEEP, width)
        peers.append((f"compiled RK4, tanh(v/{width:g}), {steps} steps a sample", smoothed))
    for steps in LOCATED_STEPS:
        located = partial(sim_compiled.located, samples, period, steps, PLANT, SWEEP)
        peers.append((f"compiled RK4, events by halving, {steps} steps a sample", located))
    for peer, solve in peers:
        found, _ = solve()  # compiles
        error = _error(found, ours.reference)
        own = ours.comparable(error)
        yield Timing(
            WORK, peer, own.seconds, best_of(3, solve, process_time), own.error, error, compiling=1.0
        )


def evaluation_time() -> float:
    """Return the time of one evaluation of the equation of motion with its part of the step, compiled, s."""
    steps, width = SMOOTHED[1]
    run = partial(sim_compiled.smoothed, round(SECONDS * RATE), 1.0 / RATE, steps, PLANT, SWEEP, width)
    _, evaluations = run()
    return best_of(3, run, process_time) / evaluations


def scipy_row(ours: Ours, method: str, friction: str, tolerance: float, evaluation: float) -> Timing:
    """Return the row of one of SciPy's solvers; ``evaluation`` is the time of a compiled one, s."""
    solved = _scipy(method, friction, tolerance)
    peer = f"solve_ivp {method}, {friction}"
    error = None
    if solved.displacement is None:
        peer = f"{peer}: no result in {solved.seconds:.0f} s"
    else:
        error = _error(solved.displacement, ours.reference)
    own = ours.comparable(error)
    compiling = solved.seconds / (solved.evaluations * evaluation)
    work = f"{WORK}, rtol {tolerance:g}"
    return Timing(work, peer, own.seconds, solved.seconds, own.error, error, compiling)


def _step(motion: ComposedMotion, forcing: Array, substeps: int) -> Array:
    trajectory, _ = motion.advance(
        MotionState(), forcing, motion.table(VALUES, 1), sample_period=1.0 / RATE, substeps=substeps
    )
    return trajectory.displacement


def _ours(motion: ComposedMotion, sweep: SweptSine, substeps: int) -> Array:
    """Return our displacement at the samples, m, the excitation computed anew."""
    times = half_step_times(0, round(SECONDS * RATE), RATE, substeps)
    return _step(motion, sweep.acceleration(times), substeps)


def _error(found: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((found - reference) ** 2) / np.mean(reference**2)))


def _scipy(method: str, friction: str, tolerance: float) -> Solved:
    """Return what one of SciPy's solvers needs and finds, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.npz"
        words = [method, friction, str(tolerance), str(CAP), str(file)]
        done = subprocess.run(
            [sys.executable, "-m", sim_peer.__name__, *words],
            check=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        if done.returncode:
            raise RuntimeError(f"bench sim: {method} with {friction} failed: {done.stderr.strip()}")
        with np.load(file) as found:
            displacement = found["displacement"] if found["displacement"].size else None
            return Solved(float(found["seconds"]), int(found["evaluations"]), displacement)


def _batches(motion: ComposedMotion, sweep: SweptSine) -> Iterator[Timing]:
    """Yield the time of 1 s for n valves against n times the time of one valve; one excitation for all."""
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

        taken = best_of(20 if count == 1 else 3, advance, process_time)
        one = one or taken
        yield Timing(f"1 s of {count} valves together", f"{count} times one valve", taken, count * one)
