from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest
from spool_core.errors import InputError
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import FILM, OPTIONAL, Valve, find_valve, load_valve, shipped_valves, valve_from_mapping


def test_derived_quantities_are_those_of_the_paper(valve: Valve, valve_mapping: dict[str, Any]) -> None:
    assert valve.viscous_coefficient == pytest.approx(8.20, abs=0.005)
    assert valve.natural_frequency == pytest.approx(15.15, abs=0.005)
    assert valve.damping_ratio == pytest.approx(0.24, abs=0.005)
    thin = valve_from_mapping({**valve_mapping, "dynamic_viscosity": 0.0198, "oil": "Azolla ZS22"})
    assert thin.viscous_coefficient == pytest.approx(2.65, abs=0.005)
    assert thin.damping_ratio == pytest.approx(0.08, abs=0.005)
    stiff = valve_from_mapping({**valve_mapping, "spring_stiffness": 5846.0})
    assert stiff.natural_frequency == pytest.approx(28.68, abs=0.005)


@pytest.mark.parametrize("number", ["15e-6", "15.0e-6", "0.000015", "1.5E-5"])
def test_every_way_to_write_a_number_gives_the_same(valve_file: Path, valve_text: str, number: str) -> None:
    valve_file.write_text(valve_text.replace("15e-6", number), "utf-8")
    assert load_valve(valve_file).radial_clearance == 15.0e-6


def test_oil_is_optional(valve_file: Path, valve_text: str) -> None:
    valve_file.write_text(valve_text.replace("oil: HL68\n", ""), "utf-8")
    assert load_valve(valve_file).oil is None


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("moving_mass: 0.18\n", "", ["moving_mass", "missing"]),
        ("spool_mass:", "spoolmass:", ["spoolmass", "unknown key", "spool_mass"]),
        ("moving_mass: 0.18", "moving_mass: -0.18", ["moving_mass", "greater than 0", "-0.18"]),
        ("moving_mass: 0.18", "moving_mass: yes", ["moving_mass", "must be a number"]),
        ("moving_mass: 0.18", "moving_mass: heavy", ["moving_mass", "valid number", "heavy"]),
        ("moving_mass: 0.18", "moving_mass: .nan", ["moving_mass", "finite"]),
        ("moving_mass: 0.18", "moving_mass: 0.1", ["spool_mass", "moving_mass"]),
        ("moving_mass: 0.18", "moving_mass: 0.18\nmoving_mass: 0.2", ["moving_mass", "duplicate", "line 3"]),
        ("radial_clearance: 15e-6", "radial_clearance: 15", ["radial_clearance", "less than"]),
        ("oil: HL68", "oil: HL47", ["oil", "HL68", "Azolla ZS22"]),
        ("oil_temperature: 20", "oil_temperature: 900", ["oil_temperature"]),
        ("spool_mass: 0.172", "spool_mass: 0.0001", ["spool_mass", "less than", "kg"]),
        ("spring_stiffness: 1632.0", "spring_stiffness: 1.632", ["spring_stiffness", "N/mm?", "N/m: 1632"]),
        ("land_diameter: 0.020", "land_diameter: 20", ["land_diameter", "did you write mm?", "0.02"]),
        ("radial_clearance: 15e-6", "radial_clearance: 15", ["did you write um?", "1.5e-05"]),
        ("dynamic_viscosity: 0.0612", "dynamic_viscosity: 61.2", ["dynamic_viscosity", "mPa s?", "0.0612"]),
        ("id: valve_soft", "id: 'two words'", ["id", "two words"]),
        ("id: valve_soft", "id: [", ["line", "YAML"]),
        ("id: valve_soft\n", "- 1\n", ["YAML"]),
    ],
)
def test_wrong_file_is_refused_in_one_line(
    valve_file: Path, valve_text: str, old: str, new: str, said: list[str]
) -> None:
    assert old in valve_text
    valve_file.write_text(valve_text.replace(old, new, 1), "utf-8")
    with pytest.raises(InputError) as caught:
        load_valve(valve_file)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{valve_file}: ")
    for word in said:
        assert word in message


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (
            {"moving_mass": 180.0, "spool_mass": 172.0},
            r"moving_mass: 180 kg.*did you write g\?.* kg: moving_mass: 0\.18,",
        ),
        ({"moving_mass": 0, "land_length": "long"}, "moving_mass.*land_length"),
    ],
)
def test_masses_in_grams_and_several_faults_are_all_named(
    valve_mapping: dict[str, Any], wrong: dict[str, object], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        valve_from_mapping({**valve_mapping, **wrong})


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0])
def test_small_and_large_valves_are_believed(valve_mapping: dict[str, Any], scale: float) -> None:
    """Lengths times ``scale``, masses with its cube, springs for the same stroke under the same pressure."""
    powers = {"land_diameter": 1, "land_length": 1, "moving_mass": 3, "spool_mass": 3, "spring_stiffness": 1}
    grown = {key: valve_mapping[key] * scale**power for key, power in powers.items()}
    valve_from_mapping({**valve_mapping, **grown})


def test_missing_file_and_empty_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.yaml: cannot read the valve file: No such file"):
        load_valve(tmp_path / "absent.yaml")
    empty = tmp_path / "empty.yaml"
    empty.write_text("", "utf-8")
    with pytest.raises(InputError, match="key: value"):
        load_valve(empty)
    empty.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        load_valve(empty)


def test_valve_is_frozen(valve: Valve) -> None:
    with pytest.raises(ValueError, match="frozen"):
        valve.moving_mass = 1.0


def test_shipped_valves_are_found_by_name(valve_file: Path) -> None:
    assert {"4weh10_soft", "4weh10_stiff"} <= set(shipped_valves())
    for name in shipped_valves():
        assert find_valve(name).id == name
    assert find_valve(valve_file).id == "valve_soft"
    with pytest.raises(InputError, match=r"4weh10\.yaml: no such valve file; give one of 4weh10_soft"):
        find_valve("4weh10.yaml")


LEAST = {"id": "least", "moving_mass": 0.18, "spring_stiffness": 1632.0}


def test_a_valve_is_known_by_mass_and_springs_alone() -> None:
    valve = valve_from_mapping(LEAST)
    assert valve.natural_frequency == pytest.approx(15.15, abs=0.005)
    assert valve.given == {"moving_mass": 0.18, "spring_stiffness": 1632.0}
    assert valve == valve_from_mapping(dict(LEAST))
    assert valve.model_copy(update={"id": "other"}).given == valve.given
    assert pickle.loads(pickle.dumps(valve)) == valve
    assert hash(valve) == hash(valve_from_mapping(LEAST))


@pytest.mark.parametrize("key", sorted(OPTIONAL))
def test_whoever_needs_a_key_that_is_missing_names_it(valve_mapping: dict[str, Any], key: str) -> None:
    part = {name: value for name, value in valve_mapping.items() if name != key}
    valve = valve_from_mapping(part)
    assert not valve.knows(key)
    with pytest.raises(InputError, match=f"valve 'valve_soft': {key}: key is missing, .* needs it; add it"):
        getattr(valve, key)
    if key in FILM:
        with pytest.raises(InputError, match=f": {key}: key is missing"):
            _ = valve.viscous_coefficient
        with pytest.raises(InputError, match=f": {key}: key is missing"):
            Simulator(valve, PRESETS["sweep"])
        assert 0.1 <= valve.likely_viscous_coefficient / (2.0 * (1632.0 * 0.18) ** 0.5) <= 0.5
    if key in ("oil_temperature", "dynamic_viscosity"):
        with pytest.raises(InputError, match=f"^valve 'valve_soft': {key}: key is missing"):
            valve.dynamic_viscosity_at(40.0)


def test_a_simulation_whose_drag_is_given_needs_no_film() -> None:
    block = Simulator(
        valve_from_mapping(LEAST), PRESETS["sweep"], model="fluid", parameters={"viscous_coefficient": 5.0}
    ).next_block()
    assert block.body.size == block.spool.size > 0


def test_without_a_land_mass_and_springs_are_judged_together() -> None:
    for change in ({"moving_mass": 180.0}, {"spring_stiffness": 1.632}):
        with pytest.raises(InputError, match=r"would give way by 1.1 m .* N/mm\? .* moving_mass in g\?"):
            valve_from_mapping({**LEAST, **change})
