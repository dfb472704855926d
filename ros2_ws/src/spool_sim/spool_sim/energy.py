"""Where the energy of a motion went: input = stored + dissipated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .motion import Array, Trajectory


@dataclass(frozen=True, slots=True)
class EnergyBalance:
    """Energies in the frame of the body, J, from the first sample to the last.

    Attributes:
        supplied: work of the inertia force -m w''.
        stored: gain of kinetic energy and of the spring's energy.
        viscous: dissipated by viscous drag.
        coulomb: dissipated by dry friction.
    """

    supplied: float
    stored: float
    viscous: float
    coulomb: float

    @property
    def residual(self) -> float:
        """What is missing: supplied - stored - dissipated, J."""
        return self.supplied - self.stored - self.viscous - self.coulomb


def energy_balance(
    trajectory: Trajectory,
    body_acceleration: Array,
    *,
    sample_period: float,
    mass: float,
    viscous_coefficient: float,
    spring_stiffness: float,
    coulomb_force: float = 0.0,
) -> EnergyBalance:
    """Return the energy balance of ``trajectory``, integrated by trapezia over its samples.

    Args:
        trajectory: n samples, dense enough for the trapezia.
        body_acceleration: at the same samples, m/s^2, shape (n,).
        sample_period: s.
        mass, viscous_coefficient, spring_stiffness, coulomb_force: kg, N s/m, N/m, N; constant.
    """
    z, v = trajectory.displacement, trajectory.velocity
    energy = 0.5 * mass * v**2 + 0.5 * spring_stiffness * z**2

    def over_time(power: Array) -> float:
        return float(sample_period * (power.sum() - 0.5 * (power[0] + power[-1])))

    return EnergyBalance(
        supplied=over_time(np.asarray(-mass * body_acceleration * v)),
        stored=float(energy[-1] - energy[0]),
        viscous=over_time(np.asarray(viscous_coefficient * v**2)),
        coulomb=over_time(np.asarray(coulomb_force * np.abs(v))),
    )
