from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
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
    path.write_text(valve_text)
    return path
