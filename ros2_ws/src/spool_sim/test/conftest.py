from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_sim.integration.composed_motion import ComposedMotion, Trajectory
from spool_sim.valve import Valve, valve_from_mapping


@pytest.fixture
def valve_mapping() -> dict[str, Any]:
    return {
        "id": "valve_soft",
        "moving_mass": 0.18,
        "spool_mass": 0.172,
        "spring_stiffness": 1632.0,
        "land_diameter": 0.020,
        "land_length": 0.032,
        "radial_clearance": 15.0e-6,
        "dynamic_viscosity": 0.0612,
        "oil": "HL68",
        "oil_temperature": 20.0,
    }


@pytest.fixture
def valve(valve_mapping: dict[str, Any]) -> Valve:
    return valve_from_mapping(valve_mapping)


@pytest.fixture
def valve_text() -> str:
    return (
        "id: valve_soft\nmoving_mass: 0.18\nspool_mass: 0.172\nspring_stiffness: 1632.0\n"
        "land_diameter: 0.020\nland_length: 0.032\nradial_clearance: 15e-6\n"
        "dynamic_viscosity: 0.0612\noil: HL68\noil_temperature: 20\n"
    )


@pytest.fixture
def valve_file(tmp_path: Path, valve_text: str) -> Path:
    path = tmp_path / "valve.yaml"
    path.write_text(valve_text, "utf-8")
    return path


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


def _energy_balance(
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


@pytest.fixture(scope="session")
def energy_balance() -> Callable[..., EnergyBalance]:
    return _energy_balance
