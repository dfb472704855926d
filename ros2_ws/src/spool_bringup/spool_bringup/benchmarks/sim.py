"""Simulating dry friction: ours beside SciPy's solvers on the same problem, and many valves at once."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_sim.composed_motion import ComposedMotion, MotionState
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.motion import half_step_times

from . import sim_peer
from .sim_peer import AMPLITUDE, DRAG, FRICTION, HIGH, LOW, MASS, RATE, SECONDS, SIGNS, STIFFNESS
from .timing import Timing, best_of

Array = NDArray[np.float64]

VALUES = {
    "mass": MASS,
    "spring_stiffness": STIFFNESS,
    "viscous_coefficient": DRAG,
    "coulomb_force": FRICTION,
}
#: s that a solver may take; one that needs more has given up, and its row holds this time and no error.
CAP = 6.0
METHODS = ("LSODA", "Radau", "RK45", "BDF")
TOLERANCES = (1e-3, 1e-6, 1e-9)
BATCHES = (1, 64, 1024)


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
        taken = best_of(7, partial(_step, motion, forcing, substeps))
        runs.append((taken, _error(_ours(motion, sweep, substeps), reference)))
    for method in METHODS:
        for friction in SIGNS:
            for tolerance in TOLERANCES:
                work = f"{SECONDS:g} s of sweep with Coulomb friction, rtol {tolerance:g}"
                peer = f"solve_ivp {method}, {friction}"
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


def _scipy(method: str, friction: str, tolerance: float) -> tuple[float, Array | None]:
    """Return the time taken (s) and the displacement at the samples, or ``None`` where it gave up."""
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
            return float(found["seconds"]), found["displacement"] if found["displacement"].size else None


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
