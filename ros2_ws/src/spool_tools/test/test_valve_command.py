"""`./spool valve new` and `./spool valve check`."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest
from hypothesis import given as property_of
from hypothesis import strategies as st
from spool_core.errors import InputError
from spool_report.records.valve_sheet import QUESTIONS, asked, described, file_text, number_of
from spool_sim.valve import known_oil, load_valve, shipped_valves
from spool_tools.cli import main

ROOT = Path(__file__).resolve().parents[4]
SHEET = {
    "id": "press",
    "spool_mass": "172 g",
    "spring_mass": "15g",
    "oil_mass": "3 g",
    "spring_rate": "0.816 N/mm",
    "land_diameter": "20 mm",
    "land_length": "3.2e-2",
    "radial_clearance": "15 um",
    "oil": "iso vg68",
    "oil_temperature": "40 °C",
}


def flags(sheet: dict[str, str]) -> list[str]:
    return [word for key, value in sheet.items() for word in ("--" + key.replace("_", "-"), value)]


def test_answers_that_end_early_are_no_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)

    def ended(_question: str) -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", ended)
    assert main(["valve", "new", "--out", str(tmp_path / "valve.yaml")]) == 2
    assert "the answers ended before the last question" in capsys.readouterr().err
    assert not (tmp_path / "valve.yaml").exists()


def test_quantities_of_the_papers_valve(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["valve", "check", "4weh10_soft"]) == 0
    said = capsys.readouterr().out
    assert "15.15 Hz" in said
    assert "8.203 N s/m at 20 deg C" in said
    # (6) by hand: 8.2033 N s/m x 0.5 m/s over 0.172 kg x 9.80665 m/s^2.
    assert "friction coefficient of the oil film: 2.43" in said
    assert "up to 5 um of combined rms roughness" in said
    assert "accuracy of a measured acceleration: 5 %" in said


def test_a_data_sheet_becomes_a_file_in_si_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "press.yaml"
    assert main(["valve", "new", "--out", str(out), *flags(SHEET)]) == 0
    valve = load_valve(out)
    assert valve.moving_mass == pytest.approx(0.172 + 0.003 + 0.015 / 3.0)
    assert valve.spring_stiffness == pytest.approx(2.0 * 816.0)
    assert (valve.land_diameter, valve.land_length, valve.radial_clearance) == (0.02, 0.032, 1.5e-5)
    # ISO VG 68 is 68 mm^2/s at 40 deg C; 870 kg/m^3.
    assert valve.dynamic_viscosity == pytest.approx(68e-6 * 870.0, rel=0.005)
    assert valve.oil == "ISO VG 68"
    text = out.read_text(encoding="utf-8")
    assert all("#" in line for line in text.splitlines())
    assert "two springs of 816 N/m" in text
    capsys.readouterr()
    assert main(["valve", "check", str(out)]) == 0
    assert main(["valve", "new", "--out", str(out), *flags(SHEET)]) == 2
    assert "--force" in capsys.readouterr().err


def test_id_mass_and_frequency_are_enough_for_a_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, fitted = tmp_path / "least.yaml", tmp_path / "fit.json"
    least = ["--id", "least", "--moving-mass", "180g", "--natural-frequency", "15.2 Hz"]
    assert main(["valve", "new", "--out", str(out), *least]) == 0
    stiffness = 0.18 * (2.0 * math.pi * 15.2) ** 2
    assert load_valve(out).spring_stiffness == pytest.approx(stiffness, rel=1e-3)
    record = str(ROOT / "bags" / "practice_03")
    assert main(["fit", record, "--valve", str(out), "--json", str(fitted)]) == 0
    found = json.loads(fitted.read_text(encoding="utf-8"))["parameters"]
    # Truth of the record: bags/README.md.
    assert found["spring_stiffness"]["value"] == pytest.approx(1632.0, rel=0.01)
    assert found["coulomb_force"]["value"] == pytest.approx(0.5, rel=0.02)
    capsys.readouterr()
    assert main(["simulate", "--valve", str(out), "--out", str(tmp_path / "bag")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "dynamic_viscosity: key is missing" in said


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"id": "a"}, "the mass is missing: give --moving-mass"),
        ({"id": "a", "moving_mass": "180 g"}, "the stiffness is missing: give --spring-stiffness"),
        ({"moving_mass": "180 g", "spring_stiffness": "1632"}, "the name is missing: give --id"),
        ({"id": "a", "moving_mass": "heavy"}, "--moving-mass: 'heavy' is no number, write e.g. '180 g'"),
        ({"id": "a", "spring_rate": "0,816 N/mm"}, "--spring-rate: '0,816 N/mm' has a comma"),
        ({"id": "a", "moving_mass": "180 mm"}, "--moving-mass: unit 'mm' is none of kg, g"),
        ({"id": "a", "moving_mass": "180", "spring_stiffness": "1632"}, "moving_mass in g?"),
        (
            {"id": "a", "moving_mass": "180g", "spring_stiffness": "1632", "oil": "VG 33"},
            "--oil: unknown oil 'VG 33', known are",
        ),
        (
            {"id": "a", "spool_mass": "172kg", "spring_rate": "816", "land_diameter": "20 mm"},
            "valve new: moving_mass: 172 kg, spool_mass: 172 kg: no spool of 20 mm diameter (solid steel, 40 "
            "diameters long: 1.97 kg); did you write g? the file takes kg: moving_mass: 0.172, spool_mass: "
            "0.172; valve new takes 172g\n",
        ),
        ({"id": "two words", "moving_mass": "180g", "spring_stiffness": "1632"}, "id: string should match"),
    ],
)
def test_what_cannot_be_a_valve_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], given: dict[str, str], said: str
) -> None:
    out = tmp_path / "valve.yaml"
    assert main(["valve", "new", "--out", str(out), *flags(given)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert not out.exists()


@pytest.mark.parametrize(
    "text", ["HL46", "HLP46", "hlp 46", "HM-46", "VG 46", "ISO VG 46", "iso-l-hm 46", "46"]
)
def test_an_oil_is_known_by_its_number(text: str) -> None:
    assert (
        described({"id": "a", "moving_mass": "1", "spring_stiffness": "9e3", "oil": text})[0].oil
        == "ISO VG 46"
    )


@property_of(st.text("HLPVGMISO zZ-", max_size=9), st.integers(0, 400))
def test_no_oil_has_another_number_than_was_typed(letters: str, number: int) -> None:
    try:
        said = known_oil(f"{letters}{number}")
    except InputError as error:
        said = str(error).partition("did you mean")[2]
    assert set(re.findall(r"\d+", said)) <= {str(number)}


def test_questions_are_asked_until_answered_and_only_while_they_matter(tmp_path: Path) -> None:
    told: list[str] = []
    script = {
        "Name": iter(["", "press"]),
        "Moving mass": iter(["light", "180 g"]),
        "Stiffness": iter([""]),
        "Rate": iter(["0.816 N/mm"]),
    }
    questions: list[str] = []

    def answer(question: str) -> str:
        questions.append(question)
        return next((next(one) for start, one in script.items() if question.startswith(start)), "")

    answers = asked({"land_diameter": "20 mm"}, answer, told.append)
    assert answers == {
        "id": "press", "moving_mass": "180 g", "spring_rate": "0.816 N/mm", "land_diameter": "20 mm",
    }  # fmt: skip
    assert len(told) == 2
    assert not any("both centring springs together" in one and "Mass" in one for one in questions)
    assert not any("Natural frequency" in one for one in questions if "spring_stiffness" in answers)
    valve, how = described(answers)
    assert valve.spring_stiffness == 1632.0
    file = tmp_path / "valve.yaml"
    file.write_text(file_text(valve, how), encoding="utf-8")
    assert load_valve(file) == valve


def test_every_example_is_an_answer() -> None:
    for question in QUESTIONS:
        if question.kind != "text":
            assert math.isfinite(number_of(question, question.example))


def changed(tmp_path: Path, old: str, new: str) -> str:
    text = shipped_valves()["4weh10_soft"].read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "valve.yaml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("spring_stiffness: 1632.0", "spring_stiffness: 1.632", "did you write N/mm?"),
        ("moving_mass: 0.18 ", "moving_mass: 180 ", "did you write g?"),
        ("land_diameter: 0.020", "land_diameter: 20", "did you write mm?"),
        ("radial_clearance: 15.0e-6", "radial_clearance: 15.0e-4", "radial_clearance"),
        ("moving_mass: 0.18 ", "moving_mass: 0.172 ", "oil and a third of the springs"),
        ("dynamic_viscosity: 0.0612", "dynamic_viscosity: 61.2", "did you write mPa s?"),
        ("spring_stiffness: 1632.0", "spring_stiffness: 1632.0e4", "no spring centres a spool so stiffly"),
    ],
)
def test_slips_of_units_and_masses_look_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    out = tmp_path / "check.json"
    assert main(["valve", "check", changed(tmp_path, old, new), "--json", str(out)]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("looks wrong")]
    assert said in line
    assert said in json.loads(out.read_text(encoding="utf-8"))["wrong"][0]


def test_a_record_shows_another_spring_than_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, out = str(ROOT / "bags" / "practice_03"), tmp_path / "check.json"
    assert main(["valve", "check", "4weh10_soft", "--record", record]) == 0
    assert "the record shows 15.16 Hz: agrees with the file (15.15 Hz)" in capsys.readouterr().out
    one_spring = changed(tmp_path, "1632.0", "816.0")
    assert main(["valve", "check", one_spring, "--record", record, "--json", str(out)]) == 1
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found["record"]["spring_stiffness"]["value"] == pytest.approx(1632.0, rel=0.01)
    assert any("the rate of one spring instead of both" in said for said in found["wrong"])


def test_an_unknown_key_is_no_finding_but_wrong_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["valve", "check", changed(tmp_path, "spool_mass", "spoolmass")]) == 2
    assert "unknown key" in capsys.readouterr().err
