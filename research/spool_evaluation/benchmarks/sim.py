"""Benchmark of simulating dry friction, against SciPy's solvers and compiled schemes; many valves together.

Times are processor time; ours holds the computing of the excitation, as the peers' does. A ratio is the
product of two factors: how much longer the peer took than it would need were it compiled (its evaluations of
the equation of motion, each at the time that one takes in a compiled scheme), and the remainder for the
scheme. Work of the solver besides the evaluations counts as interpreted: of implicit ones the first factor
is too large.

Each computes the sweep itself, at the instants that it needs, and returns the displacement at the samples, m,
shape (n,), with the number of evaluations of the excitation.

Sources: Moreau, Numerical aspects of the sweeping process, 1999 (time stepping, here with the midpoint rule);
Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 1993, II.1 (Runge-Kutta of order 4) and
II.6 (location of events).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from time import process_time

import numpy as np
from spool_core.kernels.compiled import compiled, inlined
from spool_core.numbers import Array
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS

from spool_evaluation.benchmarks.sim_peer import (
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
    silence,
    solve,
)
from spool_evaluation.results.timing import Timing, best_of

VALUES = {"mass": MASS, "spring_stiffness": STIFFNESS, "viscous_coefficient": DRAG, "coulomb_force": FRICTION}
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

#: Evaluations of the equation of motion in a step of order 4.
STAGES = 4
#: Halvings that locate an event; the step is exhausted to 1e-12 of itself.
HALVINGS = 40


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
    peers: list[tuple[str, Callable[..., tuple[Array, int]], int, tuple[float, ...]]] = [
        *(("Moreau midpoint", moreau, steps, ()) for steps in MOREAU_STEPS),
        *((f"RK4, tanh(v/{width:g})", smoothed, steps, (width,)) for steps, width in SMOOTHED),
        *(("RK4, events by halving", located, steps, ()) for steps in LOCATED_STEPS),
    ]
    for name, kernel, steps, more in peers:
        peer = f"compiled {name}, {steps} steps a sample"
        scheme = partial(kernel, samples, period, steps, PLANT, SWEEP, *more)
        found, _ = scheme()  # compiles
        error = _error(found, ours.reference)
        own = ours.comparable(error)
        yield Timing(
            WORK, peer, own.seconds, best_of(3, scheme, process_time), own.error, error, compiling=1.0
        )


def evaluation_time() -> float:
    """Return the time of one evaluation of the equation of motion with its part of the step, compiled, s."""
    steps, width = SMOOTHED[1]
    run = partial(smoothed, round(SECONDS * RATE), 1.0 / RATE, steps, PLANT, SWEEP, width)
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


@compiled
def moreau(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[Array, int]:
    """Step with the midpoint rule; friction is an impulse, projected on what friction can give.

    Args:
        samples: n.
        period: s between samples.
        steps: per sample.
        plant: mass (kg), drag (N s/m), stiffness (N/m), Coulomb force (N).
        sweep: amplitude (m/s^2), first frequency (Hz), its rate (Hz/s).
    """
    mass, drag, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v = 0.0, 0.0
    # (m + h c / 2 + h^2 k / 4) v1 = (m - h c / 2 - h^2 k / 4) v0 - h k z - h m w'' - impulse of friction
    whole = mass + 0.5 * h * drag + 0.25 * h * h * stiffness
    kept = mass - 0.5 * h * drag - 0.25 * h * h * stiffness
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + (step + 0.5) * h
            count += 1
            free = kept * v - h * stiffness * z - h * mass * _body(t, amplitude, low, rate)
            # Sticking: the impulse that makes v1 = 0, where friction can give it.
            impulse = min(h * friction, max(-h * friction, free))
            after = (free - impulse) / whole
            z += 0.5 * h * (v + after)
            v = after
        found[n + 1] = z
    return found, count


@compiled
def smoothed(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
    width: float,
) -> tuple[Array, int]:
    """Step with Runge-Kutta's scheme of order 4, friction as tanh(v / ``width``), m/s; else as `moreau`."""
    mass, drag, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v = 0.0, 0.0
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + step * h
            b0 = _body(t, amplitude, low, rate)
            b1 = _body(t + 0.5 * h, amplitude, low, rate)
            b2 = _body(t + h, amplitude, low, rate)
            count += STAGES
            a0 = -b0 - (drag * v + stiffness * z + friction * math.tanh(v / width)) / mass
            z1, v1 = z + 0.5 * h * v, v + 0.5 * h * a0
            a1 = -b1 - (drag * v1 + stiffness * z1 + friction * math.tanh(v1 / width)) / mass
            z2, v2 = z + 0.5 * h * v1, v + 0.5 * h * a1
            a2 = -b1 - (drag * v2 + stiffness * z2 + friction * math.tanh(v2 / width)) / mass
            z3, v3 = z + h * v2, v + h * a2
            a3 = -b2 - (drag * v3 + stiffness * z3 + friction * math.tanh(v3 / width)) / mass
            z += h / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3)
            v += h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)
        found[n + 1] = z
    return found, count


@compiled
def located(
    samples: int,
    period: float,
    steps: int,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[Array, int]:
    """Step with order 4 from event to event; rest and break-away are located by halving, else as `moreau`."""
    mass, _, stiffness, friction = plant
    amplitude, low, rate = sweep
    h = period / steps
    found = np.zeros(samples)
    z, v, sense = 0.0, 0.0, 0.0  # at rest where sense is 0
    count = 0
    for n in range(samples - 1):
        for step in range(steps):
            t = n * period + step * h
            left = h
            for _ in range(8):  # events in a step; more of them are left to the next one
                if left <= 1e-12 * h:
                    break
                if sense == 0.0:
                    push = -mass * _body(t + left, amplitude, low, rate) - stiffness * z
                    count += 1
                    if abs(push) <= friction:
                        t, left = t + left, 0.0
                        continue
                    late, push = _break_away(t, left, z, plant, sweep)
                    count += HALVINGS + 1
                    sense = 1.0 if push > 0.0 else -1.0
                    t, left = t + late, left - late
                    continue
                z1, v1 = _slide(t, left, z, v, sense * friction, plant, sweep)
                count += STAGES
                if v1 * sense >= 0.0:
                    z, v, t, left = z1, v1, t + left, 0.0
                    continue
                early, late = 0.0, left
                for _ in range(HALVINGS):
                    middle = 0.5 * (early + late)
                    z1, v1 = _slide(t, middle, z, v, sense * friction, plant, sweep)
                    count += STAGES
                    if v1 * sense < 0.0:
                        late = middle
                    else:
                        early = middle
                z, _ = _slide(t, early, z, v, sense * friction, plant, sweep)
                v, t, left = 0.0, t + early, left - early
                push = -mass * _body(t, amplitude, low, rate) - stiffness * z
                sense = 0.0 if abs(push) <= friction else (1.0 if push > 0.0 else -1.0)
        found[n + 1] = z
    return found, count


def _ours(motion: ComposedMotion, sweep: SweptSine, substeps: int) -> Array:
    """Return our displacement at the samples, m, the excitation computed again."""
    forcing = sweep.acceleration(half_step_times(0, round(SECONDS * RATE), RATE, substeps))
    table = motion.table(VALUES, 1)
    trajectory, _ = motion.advance(MotionState(), forcing, table, sample_period=1.0 / RATE, substeps=substeps)
    return trajectory.displacement


def _error(found: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean((found - reference) ** 2) / np.mean(reference**2)))


def _scipy(method: str, friction: str, tolerance: float) -> Solved:
    """Return what one of SciPy's solvers needs and finds, in a separate process: it may write anything."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=silence) as pool:
        return pool.submit(solve, method, friction, tolerance, CAP).result()


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


@inlined
def _body(t: float, amplitude: float, low: float, rate: float) -> float:
    return amplitude * math.sin(2.0 * math.pi * (low + 0.5 * rate * t) * t)


@inlined
def _slide(
    t: float,
    h: float,
    z: float,
    v: float,
    dry: float,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[float, float]:
    """Return z and v after a step of order 4 under the constant friction ``dry``, N."""
    mass, drag, stiffness, _ = plant
    amplitude, low, rate = sweep
    b0 = _body(t, amplitude, low, rate)
    b1 = _body(t + 0.5 * h, amplitude, low, rate)
    b2 = _body(t + h, amplitude, low, rate)
    a0 = -b0 - (drag * v + stiffness * z + dry) / mass
    z1, v1 = z + 0.5 * h * v, v + 0.5 * h * a0
    a1 = -b1 - (drag * v1 + stiffness * z1 + dry) / mass
    z2, v2 = z + 0.5 * h * v1, v + 0.5 * h * a1
    a2 = -b1 - (drag * v2 + stiffness * z2 + dry) / mass
    z3, v3 = z + h * v2, v + h * a2
    a3 = -b2 - (drag * v3 + stiffness * z3 + dry) / mass
    return z + h / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3), v + h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)


@inlined
def _break_away(
    t: float,
    left: float,
    z: float,
    plant: tuple[float, float, float, float],
    sweep: tuple[float, float, float],
) -> tuple[float, float]:
    """Return how long after ``t`` a spool at rest at ``z`` begins to move, s, and the force on it, N."""
    mass, _, stiffness, friction = plant
    amplitude, low, rate = sweep
    early, late = 0.0, left
    for _ in range(HALVINGS):
        middle = 0.5 * (early + late)
        if abs(-mass * _body(t + middle, amplitude, low, rate) - stiffness * z) > friction:
            late = middle
        else:
            early = middle
    return late, -mass * _body(t + late, amplitude, low, rate) - stiffness * z
