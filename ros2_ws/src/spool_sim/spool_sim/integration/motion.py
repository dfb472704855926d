"""Relative motion of the spool in its vibrating body, with dry friction as a set-valued force.

    m z'' + c z' + k z + F_c Sgn(z') = -m w''

z is the spool's displacement relative to the body, w'' the body's acceleration; Sgn(0) is the whole
interval [-1, 1]. While abs(m w'' + k z) <= F_c at rest the spool sticks: v is exactly 0. Between
events the motion is smooth and stepped by the classic Runge-Kutta scheme of order 4; reversal and
break-away are located inside the step, so the order is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from spool_stream.errors import InputError

from spool_sim.terms import term

from .composed_motion import Array, ComposedMotion, MotionState, Trajectory

__all__ = [
    "Array",
    "MotionState",
    "Trajectory",
    "advance",
    "half_step_times",
    "half_step_values",
    "step_error",
    "substeps_needed",
]

# Largest phase angle (rad) that motion or forcing may turn within one step.
LARGEST_STEP_ANGLE = 0.25
MOST_SUBSTEPS = 2000


def advance(
    state: MotionState,
    body_acceleration: Array,
    *,
    sample_period: float,
    substeps: int,
    mass: float,
    viscous_coefficient: float | Array,
    spring_stiffness: float | Array,
    coulomb_force: float | Array = 0.0,
) -> tuple[Trajectory, MotionState]:
    """Advance by n samples and return the motion at their instants and the state at the next one.

    Any split of a record into calls gives the same numbers bit for bit, when the state is handed on.

    Args:
        state: at the first sample.
        body_acceleration: m/s^2, shape (2 n substeps + 1,): at the ends and the midpoints of all
            substeps, from the first sample to the one after the last.
        sample_period: s between samples.
        substeps: steps per sample.
        mass: kg.
        viscous_coefficient: N s/m, number or shape (n,) (held from sample to sample).
        spring_stiffness: N/m, number or shape (n,).
        coulomb_force: N, number or shape (n,).

    Raises:
        ValueError: the length of ``body_acceleration`` does not fit ``substeps``.
    """
    samples = max(1, (body_acceleration.size - 1) // (2 * substeps))
    motion = coulomb_motion()
    table = motion.table(
        {
            "mass": mass,
            "spring_stiffness": spring_stiffness,
            "viscous_coefficient": viscous_coefficient,
            "coulomb_force": coulomb_force,
        },
        samples,
    )
    return motion.advance(state, body_acceleration, table, sample_period=sample_period, substeps=substeps)


@lru_cache(maxsize=1)
def coulomb_motion() -> ComposedMotion:
    """Return the motion with spring, viscous drag and Coulomb friction."""
    return ComposedMotion(
        [term(name) for name in ("inertia", "spring", "viscous_friction", "coulomb_friction")]
    )


def warm_up() -> None:
    """Compile the kernel, or load it from the disk, now instead of at the first sample."""
    coulomb_motion().warm_up()


def substeps_needed(
    sample_period: float,
    *,
    mass: float,
    viscous_coefficient: float,
    spring_stiffness: float,
    highest_frequency: float = 0.0,
) -> int:
    """Return how many steps a sample needs: the fastest rate turns at most LARGEST_STEP_ANGLE in one.

    Args:
        sample_period: s.
        mass: kg.
        viscous_coefficient: N s/m.
        spring_stiffness: N/m.
        highest_frequency: of the body acceleration, Hz.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    fastest = max(
        math.sqrt(spring_stiffness / mass), viscous_coefficient / mass, 2.0 * math.pi * highest_frequency
    )
    needed = max(1, math.ceil(fastest * sample_period / LARGEST_STEP_ANGLE))
    if needed > MOST_SUBSTEPS:
        raise InputError(
            f"sample period {sample_period:g} s needs {needed} steps a sample for a time constant of "
            f"{1.0 / fastest:g} s (at most {MOST_SUBSTEPS}); raise the rate or check mass, stiffness, damping"
        )
    return needed


def half_step_times(first_sample: int, samples: int, sample_rate: float, substeps: int) -> Array:
    """Return the times (s, from sample 0) at which ``advance`` wants the body acceleration.

    Times come from whole numbers, so that neighbouring calls share their border bit for bit.
    """
    first = 2 * substeps * first_sample
    index = np.arange(first, first + 2 * substeps * samples + 1, dtype=np.int64)
    return index / (2.0 * substeps * sample_rate)


def half_step_values(samples: Array, substeps: int) -> Array:
    """Return sampled body acceleration at the half steps that ``advance`` wants.

    Local polynomials of degree 5 through the six nearest samples (fewer than six: all of them).

    Args:
        samples: m/s^2, shape (n,), n >= 2.
        substeps: steps per sample.

    Returns:
        Shape (2 (n - 1) substeps + 1,).

    Raises:
        ValueError: fewer than two samples.
    """
    if samples.size < 2:
        raise ValueError("at least two samples are needed")
    width = min(6, samples.size)
    position = np.arange(2 * substeps * (samples.size - 1) + 1) / (2.0 * substeps)
    first = np.clip(position.astype(np.int64) - (width // 2 - 1), 0, samples.size - width)
    local = position - first
    values = np.zeros(position.size)
    for node in range(width):
        weight = np.ones(position.size)
        for other in range(width):
            if other != node:
                weight *= (local - other) / (node - other)
        values += weight * samples[first + node]
    return values


def step_error(
    body_acceleration: Callable[[Array], Array],
    *,
    seconds: float,
    sample_rate: float,
    substeps: int,
    mass: float,
    viscous_coefficient: float,
    spring_stiffness: float,
    coulomb_force: float = 0.0,
) -> float:
    """Return the step error of the displacement, by halving: rms of the difference over rms.

    Args:
        body_acceleration: function of time (s) in m/s^2.
        seconds: length of the trial.
        sample_rate: Hz.
        substeps: steps per sample of the coarser run.
        mass, viscous_coefficient, spring_stiffness, coulomb_force: kg, N s/m, N/m, N.
    """
    runs = []
    for count in (substeps, 2 * substeps):
        times = half_step_times(0, max(1, round(seconds * sample_rate)), sample_rate, count)
        trajectory, _ = advance(
            MotionState(),
            body_acceleration(times),
            sample_period=1.0 / sample_rate,
            substeps=count,
            mass=mass,
            viscous_coefficient=viscous_coefficient,
            spring_stiffness=spring_stiffness,
            coulomb_force=coulomb_force,
        )
        runs.append(trajectory.displacement)
    scale = float(np.sqrt(np.mean(runs[1] ** 2)))
    return float(np.sqrt(np.mean((runs[0] - runs[1]) ** 2))) / scale if scale > 0.0 else 0.0
