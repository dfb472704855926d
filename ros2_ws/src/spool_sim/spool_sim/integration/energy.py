"""Energy balance of a motion: supplied = stored + dissipated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .composed_motion import Array, ComposedMotion, Trajectory


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
