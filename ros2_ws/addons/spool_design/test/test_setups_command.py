"""`fit --setups`: files, numbers, and one line for each thing that a file of set-ups can get wrong."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from spool_core.uncertainty import Z_95
from spool_report.evidence.exhibit import STYLES
from spool_sim.model import load_model
from spool_tools.cli import main

VALVE = """
id: {name}
moving_mass: {mass}
spring_stiffness: {stiffness}
land_diameter: 0.020
land_length: 0.032
radial_clearance: 15.0e-6
dynamic_viscosity: {viscosity}
oil: {oil}
oil_temperature: 20.0
"""
#: The paper's four series: springs (N/m, of the pair) and oil.
SERIES = {
    "series_1": (1632.0, "Azolla ZS22", 0.0198),
    "series_2": (5846.0, "HL68", 0.0612),
    "series_3": (5846.0, "Azolla ZS22", 0.0198),
    "series_4": (1632.0, "HL68", 0.0612),
}
MASS = 0.19


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a fit to the paper's series, each simulated with a mass of 0.19 kg."""
    folder = tmp_path_factory.mktemp("setups")
    setups = []
    for name, (stiffness, oil, viscosity) in SERIES.items():
        valve = folder / f"{name}.yaml"
        valve.write_text(
            VALVE.format(name=name, mass=MASS, stiffness=stiffness, viscosity=viscosity, oil=oil), "utf-8"
        )
        simulated = ["--valve", str(valve), "--model", "fluid", "--seconds", "6", "--out", str(folder / name)]
        assert main(["simulate", *simulated]) == 0
        known: dict[str, Any] = {"spring_stiffness": stiffness}
        if oil != "HL68":
            known |= {"oil": oil, "dynamic_viscosity": viscosity, "oil_temperature": 20.0}
        setups.append({"name": name, "records": [name], "known": known})
    file = folder / "setups.yaml"
    file.write_text(
        yaml.safe_dump({"setups": setups, "shared": ["mass", "viscous_coefficient", "spool_gain"]}), "utf-8"
    )
    outputs = ["--json", str(folder / "fit.json"), "--report", str(folder / "fit.html")]
    outputs += ["--save-model", str(folder / "model.yaml")]
    assert main(["fit", "--setups", str(file), "--valve", "4weh10_soft", "--model", "fluid", *outputs]) == 0
    return folder


def test_the_papers_series_determine_mass_and_drag_by_their_known_springs_and_oils(fitted: Path) -> None:
    found = json.loads((fitted / "fit.json").read_text("utf-8"), parse_constant=pytest.fail)
    drag = 8.202
    for name, true in (("mass", MASS), ("viscous_coefficient", drag), ("spool_gain", 0.0)):
        number = found["parameters"][name]
        assert abs(number["value"] - true) < Z_95 * number["std"]
        assert found["determined"][name]["verdict"] == "identifiable"
    assert list(found["setups"]) == list(SERIES)
    thin = found["setups"]["series_1"]
    assert thin["known"]["oil"] == "Azolla ZS22"
    assert thin["parameters"]["viscous_coefficient"]["value"] == pytest.approx(drag * 198 / 612, rel=0.01)


def test_each_set_up_has_a_model_file_and_the_report_a_picture(fitted: Path) -> None:
    for name, (stiffness, _, _) in SERIES.items():
        model = load_model(fitted / f"model_{name}.yaml")
        assert model.values["spring_stiffness"] == stiffness
    page = (fitted / "fit.html").read_text("utf-8")
    assert "from all set-ups together" in page
    intervals = base64.b64decode(re.findall(r"image/svg\+xml;base64,([^\"]+)", page)[0]).decode().lower()
    assert all(f"stroke: {colour.lower()}" in intervals for colour, _, _ in STYLES[: len(SERIES)])


def test_a_known_stiffness_is_doubted_where_its_record_shows_another_and_a_fitted_one_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setups = []
    for name, valve, known in (
        ("stated", "4weh10_soft", {"spring_stiffness": 5846.0}),
        ("free", "4weh10_stiff", {}),
    ):
        words = ["--valve", valve, "--model", "fluid", "--excitation", "multisine", "--sample-rate", "500"]
        assert main(["simulate", *words, "--seconds", "20", "--out", str(tmp_path / name)]) == 0
        setups.append({"name": name, "records": [name], "known": known})
    file = tmp_path / "setups.yaml"
    file.write_text(yaml.safe_dump({"setups": setups, "shared": ["mass"]}), "utf-8")
    capsys.readouterr()
    assert main(["fit", "--setups", str(file), "--valve", "4weh10_soft", "--model", "fluid"]) == 0
    (doubt,) = [line for line in capsys.readouterr().err.splitlines() if "the record shows" in line]
    assert doubt.startswith(
        "warning: stated: the valve file of '4weh10_soft' says 28.7 Hz, the record shows 15.2 Hz"
    )


def entry(name: str, **known: object) -> dict[str, Any]:
    return {"name": name, "records": [f"{name}.csv"], "known": known}


@pytest.mark.parametrize(
    ("setups", "shared", "words"),
    [
        (
            [entry("a")],
            [],
            "setups.yaml: setups: a joint fit needs 2 set-ups at least, here are 1: add set-ups",
        ),
        ([], [], "setups.yaml: setups: a joint fit needs 2 set-ups at least, here are 0"),
        ([entry("a", springs=1.0), entry("b")], [], "set-up 1 'a': known: springs: unknown key"),
        ([{**entry("a"), "knwn": 1}, entry("b")], [], "set-up 1 'a': knwn: unknown key"),
        ([{"name": "a"}, entry("b")], [], "set-up 1 'a': records: key is missing"),
        ([entry("a"), entry("a")], [], "another set-up has the name 'a'"),
        ([entry("a", spring_stiffness=-5.0), entry("b")], [], "known: spring_stiffness: input should be"),
        (
            [entry("a", added_mass="heavy"), entry("b")],
            [],
            "known: added_mass: input should be a valid number",
        ),
        ([entry("a", oil="Azolla ZS22"), entry("b")], [], "add its dynamic_viscosity"),
        ([entry("a", oil="water", dynamic_viscosity=0.001), entry("b")], [], "oil: unknown oil"),
        ([entry("a"), entry("b")], ["masss"], "shared: masss: unknown parameter of model 'fluid'"),
        ([entry("a"), entry("b")], [{"mass": ["a"]}], "shared: mass: name 2 set-ups at least"),
        ([entry("a"), entry("b")], [{"mass": ["a", "c"]}], "shared: mass: no set-up 'c', there are a, b"),
        (
            [entry("a"), entry("b")],
            ["mass", {"mass": ["a", "b"]}],
            "shared: mass: set-up 'a' is listed twice",
        ),
        (
            [entry("a", spring_stiffness=1632.0), entry("b")],
            ["spring_stiffness"],
            "shared: spring_stiffness: set-up 'a' has it among what is known",
        ),
    ],
)
def test_what_a_file_of_set_ups_gets_wrong_is_one_line(
    setups: list[dict[str, Any]],
    shared: list[object],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "setups.yaml"
    file.write_text(yaml.safe_dump({"setups": setups, "shared": shared}), "utf-8")
    assert main(["fit", "--setups", str(file), "--valve", "4weh10_soft", "--model", "fluid"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def test_missing_records_of_set_ups_are_refused_together_before_any_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "here.csv").write_text("nonsense that reading would refuse first", "utf-8")
    setups = [{**entry("first"), "records": ["here.csv"]}, entry("a"), entry("b")]
    file = tmp_path / "setups.yaml"
    file.write_text(yaml.safe_dump({"setups": setups}), "utf-8")
    assert main(["fit", "--setups", str(file), "--valve", "4weh10_soft", "--model", "fluid"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    missing = f"set-up 'a': {tmp_path / 'a.csv'}, set-up 'b': {tmp_path / 'b.csv'}"
    assert f"{file}: no such record: {missing}: correct the names of the files" in line


def test_a_shared_parameter_that_is_fixed_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "setups.yaml"
    file.write_text(yaml.safe_dump({"setups": [entry("a"), entry("b")], "shared": ["mass"]}), "utf-8")
    given = ["--valve", "4weh10_soft", "--model", "fluid", "--fix", "mass=0.2"]
    assert main(["fit", "--setups", str(file), *given]) == 2
    assert "shared: mass: --fix holds it" in capsys.readouterr().err


def test_records_beside_a_file_of_set_ups_and_neither_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", "record", "--setups", "setups.yaml"]) == 2
    assert "its file names the records" in capsys.readouterr().err
    assert main(["fit"]) == 2
    assert "name a record, or a file of set-ups with --setups" in capsys.readouterr().err
