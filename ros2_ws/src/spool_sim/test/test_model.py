from __future__ import annotations

from pathlib import Path

import pytest
from spool_core.errors import InputError
from spool_sim.model import MODELS, load_model, model_from_mapping
from spool_sim.valve import Valve


def test_start_values_come_from_the_valve(valve: Valve) -> None:
    values = MODELS["fluid"].values_for(valve)
    assert values == {
        "mass": valve.moving_mass,
        "spring_stiffness": valve.spring_stiffness,
        "viscous_coefficient": valve.viscous_coefficient,
    }
    assert MODELS["coulomb"].values_for(valve, {"coulomb_force": 0.7})["coulomb_force"] == 0.7


def test_model_file(tmp_path: Path, valve: Valve) -> None:
    path = tmp_path / "worn.yaml"
    path.write_text(
        "name: worn\nterms: [inertia, spring, viscous_friction, coulomb_friction]\n"
        "parameters: {coulomb_force: 1e-1, spring_stiffness: 1500}\n",
        "utf-8",
    )
    model = load_model(path)
    values = model.values_for(valve)
    assert model.name == "worn"
    assert values["coulomb_force"] == 0.1
    assert values["spring_stiffness"] == 1500.0
    assert values["mass"] == valve.moving_mass


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"terms": ["inertia", "spring", "magnet"]}, "unknown force term 'magnet'"),
        ({"terms": ["inertia", "viscous_friction"]}, "'spring' must stand in the list exactly once"),
        ({"terms": ["inertia", "spring", "spring"]}, "'spring' must stand"),
        ({"parameters": {"coulomb_force": 1.0}}, "coulomb_force: unknown parameter"),
        ({"parameters": {"spring_stiffness": -1.0}}, "spring_stiffness: -1 N/m is out of range"),
        ({"colour": "red"}, "colour: unknown key"),
    ],
)
def test_wrong_model_is_refused(change: dict[str, object], said: str) -> None:
    mapping = {"name": "mine", "terms": ["inertia", "spring", "viscous_friction"], **change}
    with pytest.raises(InputError, match=said):
        model_from_mapping(mapping, "mine.yaml")


def test_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="fluid, coulomb"):
        load_model("fluit")
