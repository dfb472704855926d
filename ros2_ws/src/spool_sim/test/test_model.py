from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_sim.model import MODELS, load_model, model_from_mapping
from spool_sim.terms import TERMS, Term
from spool_sim.valve import Valve


def test_registry_finds_the_terms_of_the_folder() -> None:
    assert {"inertia", "spring", "viscous_friction", "coulomb_friction"} <= set(TERMS)


@pytest.mark.parametrize("entry", TERMS.values(), ids=TERMS.keys())
def test_every_term_tells_about_itself(entry: Term) -> None:
    for text in (entry.name, entry.law, entry.source, entry.meaning):
        assert text.strip()
    assert type(entry).__module__.endswith(f".{entry.name}")
    for parameter in entry.parameters:
        assert parameter.low <= parameter.start <= parameter.high
        assert parameter.unit
        assert parameter.meaning


@pytest.mark.parametrize("name", ["viscous_friction", "coulomb_friction"])
def test_friction_is_odd_and_dissipates(name: str) -> None:
    velocity = np.linspace(-0.5, 0.5, 101)
    zero = np.zeros(velocity.size)
    entry = TERMS[name]
    values = {parameter.name: parameter.start for parameter in entry.parameters}
    force = entry.force(zero, velocity, zero, values)
    assert np.all(force[velocity != 0.0] * velocity[velocity != 0.0] > 0.0)
    np.testing.assert_allclose(force, -entry.force(zero, -velocity, zero, values))


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
