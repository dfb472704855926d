"""`fit` and `compare` on records that another simulator made, see bags/README.md, and on simulated ones."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict
from spool_core.errors import InputError
from spool_report.outputs import suite_version
from spool_report.requests import FitRequest
from spool_report.runs.fit_run import fit_settings
from spool_sim.model import load_model
from spool_sim.valve import find_valve
from spool_tools.cli import main

BAGS = Path(__file__).resolve().parents[4] / "bags"
SOFT = ("--valve", "4weh10_soft")
MakeBag = Callable[[Path, Mapping[str, Any]], Path]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Number(Strict):
    value: float | None
    std: float | None
    unit: str


class Determined(Strict):
    unit: str
    verdict: str
    low: float | None
    high: float | None
    together_with: list[str]
    at_start: str | None
    held_at: float | None
    sentence: str


class Held(Strict):
    value: float
    unit: str


class Correlation(Strict):
    parameters: list[str]
    matrix: list[list[float]]


class Ratios(Strict):
    frequency_Hz: list[float]  # noqa: N815
    ratio: list[float | None]


class Reading(Strict):
    kind: str
    order: float
    corner_Hz: float | None  # noqa: N815
    body_corner_Hz: float | None  # noqa: N815
    shape: float


class FitResult(Strict):
    records: list[str]
    held_out_records: list[str]
    valve: str
    model: str
    terms: list[str]
    converged: bool
    stopped_early: bool
    reason: str | None
    warnings: list[str]
    parameters: dict[str, Number]
    combinations: dict[str, Number]
    not_observable: list[str]
    at_bound: list[str]
    determined: dict[str, Determined]
    held: dict[str, Held]
    observation: Reading
    correlation: Correlation
    objective: float | None
    nrmse: float | None
    nrmse_held_out: float | None
    amplitude_ratio: float | None
    amplitude_ratios: Ratios
    natural_frequency_Hz: float | None  # noqa: N815
    damping_ratio: float | None
    information_criterion: float | None
    effective_samples: float | None
    seconds: float | None
    seconds_held_out: float
    samples: int


class Left(Strict):
    value: float | None
    unit: str


class Place(Strict):
    model: str
    parameters: int
    error: Left
    error_over_least: float | None
    information_criterion: float | None
    information_criterion_behind: float | None
    objective: float | None
    amplitude_ratio: float | None
    nrmse: float | None
    nrmse_held_out: float | None
    reason: str | None
    doubt: str


class OneSeries(Strict):
    records: list[str]
    held_out_records: list[str]
    valve: str
    models: dict[str, FitResult]


class Comparison(Strict):
    preferred: str | None
    equal: list[str]
    verdict: str
    ranking: list[Place]
    series: list[OneSeries]


def read(path: Path) -> Any:
    """Return the JSON, which must not hold NaN or infinity."""
    return json.loads(path.read_text("utf-8"), parse_constant=pytest.fail)


class Page(HTMLParser):
    """Collects pictures, and addresses that a page would have to load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pictures: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag == "img":
            self.pictures.append(given["src"] or "")
        self.loaded += [
            value
            for key, value in attrs
            if key in ("src", "href") and value and not value.startswith("data:")
        ]


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a fit of Coulomb friction to the record that was made with it."""
    folder = tmp_path_factory.mktemp("fit") / "out"
    assert main(["fit", str(BAGS / "practice_03"), *SOFT, "--model", "coulomb", "--out", str(folder)]) == 0
    return folder


# One model.


def test_the_numbers_are_true_to_a_two_thousandth(fitted: Path) -> None:
    found = FitResult.model_validate(read(fitted / "fit.json"))
    assert found.converged
    for name, true in (("spring_stiffness", 1632.0), ("viscous_coefficient", 4.0), ("coulomb_force", 0.5)):
        number = found.parameters[name]
        assert number.value is not None
        assert number.std is not None
        assert number.value == pytest.approx(true, rel=5e-4)
        assert number.std < 1e-3 * true
    assert found.held["mass"] == Held(value=0.18, unit="kg")
    assert found.natural_frequency_Hz == pytest.approx(15.15, abs=0.01)
    assert found.amplitude_ratio == pytest.approx(1.0, abs=0.02)


def test_the_json_is_of_one_piece(fitted: Path) -> None:
    found = FitResult.model_validate(read(fitted / "fit.json"))
    matrix = np.array(found.correlation.matrix)
    assert matrix.shape == (len(found.correlation.parameters),) * 2
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    assert len(found.amplitude_ratios.frequency_Hz) == len(found.amplitude_ratios.ratio)
    assert found.seconds is not None
    assert 0.2 < found.seconds_held_out / (found.seconds + found.seconds_held_out) < 0.3


def test_the_saved_model_moves_the_spool_as_the_record_says(fitted: Path, tmp_path: Path) -> None:
    found = FitResult.model_validate(read(fitted / "fit.json"))
    model = load_model(fitted / "model.yaml")
    assert {name: model.values[name] for name in found.parameters} == {
        name: number.value for name, number in found.parameters.items()
    }
    excitation = ("--excitation", str(BAGS / "practice_03"), "--seconds", "12", "--noise", "0")
    again = str(tmp_path / "again")
    assert main(["simulate", "--model", str(fitted / "model.yaml"), *excitation, "--out", again]) == 0
    assert main(["fit", again, "--model", "coulomb", "--json", str(tmp_path / "j")]) == 0
    again = FitResult.model_validate(read(tmp_path / "j"))
    for name, number in found.parameters.items():
        assert again.parameters[name].value == pytest.approx(number.value, rel=5e-3)


def test_the_page_stands_by_itself(fitted: Path) -> None:
    text = (fitted / "fit.html").read_text("utf-8")
    page = Page(text)
    # Four of the fit, and three of evidence.
    assert len(page.pictures) == 4 + 3
    assert all(picture.startswith("data:image/svg+xml;base64,") for picture in page.pictures)
    assert not page.loaded
    assert len(text.encode()) < 2_000_000
    assert "spring stiffness" in text
    outside_pictures = re.sub(r'base64,[^"]+', "", text)
    assert "nan" not in outside_pictures.lower().split()
    assert not re.search(r"https?:", outside_pictures)
    assert "Copyright (c) 2022 Leon Sorokin" in text


def test_the_page_says_what_it_was_made_from(fitted: Path) -> None:
    text = (fitted / "fit.html").read_text("utf-8")
    foot = text[text.index("<footer>") :]
    (record,) = (BAGS / "practice_03").glob("*.mcap")
    assert hashlib.sha256(record.read_bytes()).hexdigest() in foot
    assert suite_version() in foot
    assert f"./spool fit {BAGS / 'practice_03'} --valve 4weh10_soft --model coulomb --out" in foot
    assert "4weh10_soft: 0.18 kg, 1632 N/m, 15.2 Hz" in foot
    assert re.search(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", foot)


def test_the_page_fits_narrow_and_dark_screens(fitted: Path) -> None:
    text = (fitted / "fit.html").read_text("utf-8")
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert "@media (prefers-color-scheme:dark)" in text
    # Whatever is wider than the screen scrolls within its own box.
    for tag in ("<table", "<img"):
        assert text.count(f'<div class="wide">{tag}') == text.count(tag) > 0


def test_what_is_seen_in_a_picture_is_said(fitted: Path) -> None:
    said = re.findall(r'<img alt="([^"]*)"', (fitted / "fit.html").read_text("utf-8"))
    assert len(said) == len(set(said)) >= 3
    assert any(re.search(r"leaves [0-9.]+ %", text) for text in said)
    assert any(re.search(r"ratio: coulomb [0-9.]+", text) for text in said)


def test_every_picture_of_evidence_says_how_to_read_it_and_what_it_shows(fitted: Path) -> None:
    text = (fitted / "fit.html").read_text("utf-8")
    evidence = text[text.index("<summary>Evidence</summary>") :]
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", evidence, re.S)
    assert len(captions) == evidence.count("<h3>") == 3
    for caption in captions:
        seen, _, how = caption.partition("How to read it:")
        assert re.search(r"\d", seen)
        assert "Good:" in how
        assert "Bad:" in how


def test_print_shows_the_picture_in_place_of_what_can_be_zoomed(fitted: Path) -> None:
    text = (fitted / "fit.html").read_text("utf-8")
    printed = text[text.index("@media print") :]
    assert "figure.zoom.on .live,figure.zoom button{display:none}" in printed
    assert "figure.zoom.on .still{display:block}" in printed
    assert text.count('<div class="still"><div class="wide"><img') == text.count('<figure class="zoom">') > 0


def test_the_terminal_shows_value_deviation_and_unit(capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ["fit", str(BAGS / "practice_01"), *SOFT, "--model", "fluid", "--stop", "12"]
    assert main(arguments) == 0
    shown = capfd.readouterr()
    assert re.search(r"spring stiffness +16\d\d\.\d+ +\d\.\d+ +N/m", shown.out)
    assert re.search(r"mass +0\.18 +kg +fixed", shown.out)
    assert "error on held-out data, of the spool's rms" in shown.out
    assert shown.err == ""


def test_a_parameter_that_is_held_is_not_fitted(tmp_path: Path) -> None:
    words = "--model coulomb --fix coulomb_force=0 --stop 12 --json"
    options = [*words.split(), str(tmp_path / "j")]
    assert main(["fit", str(BAGS / "practice_01"), *SOFT, *options]) == 0
    found = FitResult.model_validate(read(tmp_path / "j"))
    assert sorted(found.parameters) == ["spring_stiffness", "viscous_coefficient"]
    assert found.held["coulomb_force"].value == 0.0
    assert found.parameters["viscous_coefficient"].value == pytest.approx(4.0, rel=0.01)


def test_what_to_hold_and_to_free_is_checked() -> None:
    model, valve = load_model("mixed"), find_valve("4weh10_soft")
    asked = FitRequest(free=["normal_load=2"], fix=["mixed_velocity", "mixed_root_coefficient=0"])
    settings = fit_settings(model, valve, asked)
    assert settings.held == {"mixed_velocity": 0.01, "mixed_root_coefficient": 0.0}
    assert settings.free == ("normal_load",)
    assert settings.start == {"normal_load": 2.0}
    for free, fixed, said in (
        (["mass"], ["mass=1"], "mass: given to --free and to --fix"),
        ([], ["mas=1"], "--fix: mas: unknown parameter of model 'mixed', known are mass"),
        ([], ["mass=heavy"], "--fix mass=heavy: 'heavy' is not a number: write mass=1.5"),
        ([], ["mass=-1"], "--fix: mass: -1 kg is out of range"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            fit_settings(model, valve, FitRequest(free=free, fix=fixed))


# Wrong input: one line, exit code 2.


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("practice_03",), "does not describe its valve: name a valve file with --valve"),
        (("practice_03", *SOFT, "--model", "coulom"), "coulom: no such model; give one of fluid"),
        (("practice_03", *SOFT, "--stop", "1"), "too short for an estimate, which needs 2 s"),
        (("practice_03", *SOFT, "--start", "60"), "no sample from --start 60 s on: it is 40.0 s long"),
        (("practice_99", *SOFT), "practice_99: no such bag"),
        (("practice_03", *SOFT, "--name", "valve_7"), "no valve 'valve_7': the bag has valve_1"),
    ],
)
@pytest.mark.parametrize("command", ["fit", "compare"])
def test_wrong_input_is_one_line(
    command: str, arguments: tuple[str, ...], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    record, *options = arguments
    if command == "compare":
        options = ["--models" if option == "--model" else option for option in options]
    assert main([command, str(BAGS / record), *options]) == 2
    shown = capfd.readouterr()
    assert said in shown.err
    assert shown.err.count("\n") == 1
    assert shown.out == ""


# Models side by side.


@pytest.mark.parametrize(("name", "preferred"), [("practice_01", "fluid"), ("practice_03", "coulomb")])
def test_the_model_that_a_record_was_made_with_is_preferred(
    name: str, preferred: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    models = ("--models", "coulomb_hydrodynamic,coulomb,fluid", "--stop", "16")
    assert main(["compare", str(BAGS / name), *SOFT, *models, "--out", str(out)]) == 0
    found = Comparison.model_validate(read(out / "compare.json"))
    assert found.preferred == preferred
    assert found.ranking[0].model == preferred
    printed = capfd.readouterr().out
    assert f"{preferred} is preferred" in printed
    known = "fluid, before the fit: The record determines: spring stiffness, viscous coefficient; mass: known"
    assert known in printed
    assert known in (out / "compare.html").read_text("utf-8")
    fluid = read(out / "compare.json")["series"][0]["models"]["fluid"]
    assert fluid["determined"]["spring_stiffness"]["verdict"] == "identifiable"
    if preferred == "coulomb":
        last = found.ranking[-1]
        assert last.model == "fluid"
        assert last.error_over_least is not None
        assert last.error_over_least > 10.0
    page = Page((out / "compare.html").read_text("utf-8"))
    assert len(page.pictures) == 5
    assert not page.loaded


def test_every_record_is_a_series_and_the_ranking_is_over_all(tmp_path: Path) -> None:
    records = [str(BAGS / "practice_03"), str(BAGS / "practice_04")]
    valves = (*SOFT, "--valve", "4weh10_stiff")
    options = ("--models", "fluid,coulomb", "--stop", "16", "--json", str(tmp_path / "j"))
    assert main(["compare", *records, *valves, *options]) == 0
    found = Comparison.model_validate(read(tmp_path / "j"))
    assert found.preferred == "coulomb"
    assert [one.valve for one in found.series] == ["4weh10_soft", "4weh10_stiff"]
    forces = [one.models["coulomb"].parameters["coulomb_force"].value for one in found.series]
    assert forces == pytest.approx([0.5, 0.3], rel=0.01)
    means = {place.model: place.objective for place in found.ranking}
    objectives = [one.models["fluid"].objective or math.nan for one in found.series]
    assert means["fluid"] == pytest.approx(sum(objectives) / 2.0)


def test_a_short_record_is_judged_by_what_was_fitted(tmp_path: Path) -> None:
    options = ("--models", "fluid,coulomb", "--start", "8", "--stop", "14", "--json", str(tmp_path / "j"))
    assert main(["compare", str(BAGS / "practice_03"), *SOFT, *options]) == 0
    found = Comparison.model_validate(read(tmp_path / "j"))
    assert found.preferred == "coulomb"
    assert [place.nrmse_held_out for place in found.ranking] == [None, None]
    assert all(place.error.value for place in found.ranking)
    assert found.series[0].models["coulomb"].seconds_held_out == 0.0


def test_valves_and_models_must_fit(make_bag: MakeBag, recorded: Any, tmp_path: Path) -> None:
    records = [str(BAGS / "practice_03"), str(BAGS / "practice_04"), str(BAGS / "practice_01")]
    assert main(["compare", *records, *SOFT, *SOFT]) == 2
    assert main(["compare", records[0], *SOFT, "--models", "fluid,fluid"]) == 2
    assert main(["compare", *records, *SOFT, "--holdout", records[0]]) == 2
    two = make_bag(tmp_path / "two", {"left": recorded(seconds=3.0), "right": recorded(seconds=3.0)})
    assert main(["compare", str(two)]) == 2
    assert main(["fit", str(two), "--model", "fluid", "--valve", "left"]) == 0
