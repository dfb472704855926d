"""Step size of the integration, and the energy balance that checks it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_sim.integration.composed_motion import ComposedMotion, MotionState, Trajectory
from spool_sim.terms import Term

#: rad that motion or forcing may turn within one step: the README's table of errors holds for it.
LARGEST_STEP_ANGLE = 0.25
#: Steps per sample beyond which parameters are wrong rather than stiff: at 2 kHz time constants below 1 us.
MOST_SUBSTEPS = 2000
#: Range of motion (m, m/s) in which rates are looked for: the stroke of a valve this size, and its speed.
LARGEST_DISPLACEMENT = 5e-3
SPEEDS = tuple(1e-4 * 2.0**power for power in range(14))
#: Rates of forces that grow with time are taken at its start and after this time, s.
LATEST_TIME = 60.0


def slopes(
    entry: Term, values: Mapping[str, float], largest_displacement: float = LARGEST_DISPLACEMENT
) -> tuple[float, float]:
    """Return the steepest change of a term's force with displacement (N/m) and with velocity (N s/m)."""
    given = tuple(float(values[parameter.name]) for parameter in entry.parameters)
    return _slopes(entry, given, largest_displacement)


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


def substeps_for(
    terms: Sequence[Term], values: Mapping[str, float], sample_period: float, highest_frequency: float = 0.0
) -> int:
    """Return how many steps a sample needs for the stiffest rate of ``terms``.

    Args:
        terms: with inertia among them.
        values: parameters by name.
        sample_period: s.
        highest_frequency: of the body acceleration, Hz.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    steepest = [slopes(entry, values) for entry in terms]
    return substeps_needed(
        sample_period,
        mass=values["mass"],
        viscous_coefficient=sum(damping for _, damping in steepest),
        spring_stiffness=sum(stiffness for stiffness, _ in steepest),
        highest_frequency=max(highest_frequency, values.get("force_frequency", 0.0)),
    )


def half_step_times(first_sample: int, samples: int, sample_rate: float, substeps: int) -> Array:
    """Return the times (s, from sample 0) at which ``ComposedMotion.advance`` wants the body acceleration.

    Times come from whole numbers, so that neighbouring calls share their border bit for bit.
    """
    first = 2 * substeps * first_sample
    index = np.arange(first, first + 2 * substeps * samples + 1, dtype=np.int64)
    return index / (2.0 * substeps * sample_rate)


def halving_error(
    motion: ComposedMotion,
    values: Mapping[str, float],
    body_acceleration: Callable[[Array], Array],
    *,
    seconds: float,
    sample_rate: float,
    substeps: int,
) -> float:
    """Return the step error of the displacement, by halving the step: rms of the difference over rms.

    Args:
        motion: the composition.
        values: parameters by name.
        body_acceleration: function of time (s) in m/s^2.
        seconds: length of the trial.
        sample_rate: Hz.
        substeps: steps per sample of the coarser run.
    """
    samples = max(1, round(seconds * sample_rate))
    runs = []
    for count in (substeps, 2 * substeps):
        forcing = body_acceleration(half_step_times(0, samples, sample_rate, count))
        trajectory, _ = motion.advance(
            MotionState(),
            forcing,
            motion.table(values, samples),
            sample_period=1.0 / sample_rate,
            substeps=count,
        )
        runs.append(trajectory.displacement)
    scale = math.sqrt(float(np.mean(runs[1] ** 2)))
    return math.sqrt(float(np.mean((runs[0] - runs[1]) ** 2))) / scale if scale > 0.0 else 0.0


def checked_substeps(
    motion: ComposedMotion,
    values: Mapping[str, float],
    body_acceleration: Callable[[Array], Array],
    *,
    seconds: float,
    sample_rate: float,
    highest_frequency: float,
    tolerance: float = 1e-3,
    doublings: int = 3,
) -> tuple[int, float]:
    """Return the steps per sample that the stiffest rate asks for, doubled while halving changes much.

    Motion with impacts can be chaotic: then no step settles it, and the error that is left is returned.

    Args:
        motion, values, body_acceleration, seconds, sample_rate: as in ``halving_error``.
        highest_frequency: of the body acceleration, Hz.
        tolerance: of the displacement, relative rms.
        doublings: of the step count at most.

    Returns:
        Steps per sample and the error that halving shows.

    Raises:
        InputError: the parameters are so stiff that more than MOST_SUBSTEPS would be needed.
    """
    substeps = substeps_for(motion.terms, values, 1.0 / sample_rate, highest_frequency)
    for _ in range(doublings + 1):
        error = halving_error(
            motion, values, body_acceleration, seconds=seconds, sample_rate=sample_rate, substeps=substeps
        )
        if error <= tolerance or 2 * substeps > MOST_SUBSTEPS:
            break
        substeps *= 2
    return substeps, error


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Energy balance of any composition in the frame of the body, J, from the first sample to the last.

    Attributes:
        supplied: work of the inertia force -m w''.
        kinetic: gain of kinetic energy.
        taken: work that each term took from the motion, by name: stored where the term has a potential, lost
            where it dissipates, below 0 where it supplies.
        stored: kinetic energy and what terms with a potential took.
        dissipated: what all other terms took.
    """

    supplied: float
    kinetic: float
    taken: Mapping[str, float]
    stored: float
    dissipated: float

    @property
    def residual(self) -> float:
        """What is missing: supplied - stored - dissipated, J."""
        return self.supplied - self.stored - self.dissipated


def energy_balance(
    motion: ComposedMotion,
    values: Mapping[str, float],
    trajectory: Trajectory,
    body_acceleration: Array,
    *,
    sample_period: float,
    first_sample: int = 0,
) -> EnergyBalance:
    """Return where the energy of ``trajectory`` went, integrated by trapezia over its samples.

    Args:
        motion: the composition that made it.
        values: parameters by name, constant.
        trajectory: n samples, dense enough for the trapezia.
        body_acceleration: at the same samples, m/s^2, shape (n,).
        sample_period: s.
        first_sample: number of the first sample since the start.
    """
    z, v = trajectory.displacement, trajectory.velocity
    time: Array = np.asarray((first_sample + np.arange(z.size)) * sample_period, dtype=np.float64)

    def work(force: Array) -> float:
        return float(sample_period * np.sum(0.5 * (force[1:] * v[1:] + force[:-1] * v[:-1])))

    taken: dict[str, float] = {}
    memory = iter(trajectory.memory.T)
    for entry in motion.terms:
        if entry.name == "inertia":
            continue
        if "memory_law" in entry.laws:
            force = next(memory)
        else:
            force = entry.force(z, v, trajectory.acceleration, values, time)
        taken[entry.name] = work(force)
    kinetic = 0.5 * values["mass"] * float(v[-1] ** 2 - v[0] ** 2)
    conserved = sum(taken[entry.name] for entry in motion.terms if entry.conserves)
    return EnergyBalance(
        supplied=work(np.asarray(-values["mass"] * body_acceleration)),
        kinetic=kinetic,
        taken=taken,
        stored=kinetic + conserved,
        dissipated=sum(taken.values()) - conserved,
    )


@lru_cache(maxsize=256)  # of many hypotheses most terms keep their numbers
def _slopes(entry: Term, given: tuple[float, ...], largest_displacement: float) -> tuple[float, float]:
    smooth, sliding, memory, levels = (
        entry.uncompiled(law) for law in ("force_law", "sliding_law", "memory_law", "levels_law")
    )
    places = np.linspace(-largest_displacement, largest_displacement, 21).tolist()
    gap = 1e-3 * largest_displacement
    reached = [0.0, places[0], places[-1]]
    if levels is not None:
        # A contact that is reached is hardly entered: what it does far inside does not count.
        kinks = levels(*given)
        places += [level + side for level in kinks for side in (-gap, gap)]
        reached = [level + 20.0 * side for level in kinks for side in (-gap, gap)]
    stiffness = damping = 0.0
    for t in (0.0, LATEST_TIME):
        if smooth is not None:
            for z in places:
                ahead, behind = smooth(z + 0.5 * gap, 0.0, t, *given), smooth(z - 0.5 * gap, 0.0, t, *given)
                stiffness = max(stiffness, abs(ahead - behind) / gap)
            for z in reached:
                for speed in SPEEDS:
                    for side in (-1.0, 1.0):
                        change = smooth(z, 2.0 * side * speed, t, *given) - smooth(z, side * speed, t, *given)
                        damping = max(damping, abs(change) / speed)
    if sliding is not None:
        for speed in SPEEDS:
            for side in (-1.0, 1.0):
                change = sliding(0.0, 2.0 * speed, side, *given) - sliding(0.0, speed, side, *given)
                damping = max(damping, abs(change) / speed)
    if memory is not None:
        stiffness = max(stiffness, abs(memory(0.0, 1e-9, 1.0, *given)) / 1e-9)
    return stiffness, damping
