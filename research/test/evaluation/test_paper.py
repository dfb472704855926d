from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_evaluation.paper import fit as reproduction
from spool_evaluation.paper.experiment import MODELS, SERIES, Plan, SteppedResponse, respond
from spool_evaluation.paper.fit import fit, full_stroke, parameters
from spool_evaluation.paper.page import run_paper
from spool_tools.cli import main

QUICK = Plan(frequencies=(15.0, 30.0, 60.0, 90.0))
#: For the whole reproduction.
QUICKER = Plan(frequencies=(30.0, 60.0))
LOCK = Plan(frequencies=(30.0, 60.0), dwell=0.2, window=0.1, sample_rate=4000.0)


def test_series_have_the_frequencies_and_drags_of_the_paper() -> None:
    frequencies = [round(series.valve.natural_frequency, 2) for series in SERIES]
    assert frequencies == [15.15, 28.68, 28.68, 15.15]
    assert [round(series.valve.viscous_coefficient, 2) for series in SERIES] == [2.65, 8.2, 2.65, 8.2]


def test_printed_means_are_those_of_the_printed_tables_but_for_model_1() -> None:
    for model in MODELS:
        mean = float(np.mean(list(model.objective.values())))
        agrees = abs(mean / model.mean_objective - 1.0) < 0.005
        assert agrees == (model.number != 1)
    assert np.mean(list(MODELS[0].objective.values())) == pytest.approx(6.21e7, rel=1e-3)


def test_simulated_amplitudes_are_those_of_linear_theory() -> None:
    series = SERIES[0]
    response = respond(series.valve, "fluid", {}, QUICK)
    omega = 2.0 * np.pi * np.array(QUICK.frequencies)
    held = series.valve.spring_stiffness + 1j * omega * series.valve.viscous_coefficient
    expected = np.abs(held / (held - series.valve.moving_mass * omega**2))
    np.testing.assert_allclose(response.body_amplitudes, QUICK.amplitude, rtol=1e-3)
    np.testing.assert_allclose(response.spool_amplitudes / response.body_amplitudes, expected, rtol=0.02)


@pytest.mark.parametrize(
    ("model", "truth"),
    [
        ("fluid", {"h": 2.2e-5}),
        ("coulomb_hydrodynamic", {"mu_0": 0.13, "K_V": 0.35}),
        ("mixed", {"C1": 0.25, "C2": 0.0015}),
    ],
)
def test_fit_finds_what_the_data_were_made_with(model: str, truth: dict[str, float]) -> None:
    series = SERIES[1]
    made = respond(series.valve, model, parameters(model, series, truth), QUICK)
    found = fit(series, model, made)
    assert dict(zip(found.names, found.values, strict=True)) == pytest.approx(truth, rel=0.01)
    assert found.ratio == pytest.approx(1.0, abs=2e-3)
    assert found.objective < 1e-2 * float(np.sum((made.spool / 0.05) ** 2))


def test_full_stroke_is_what_linear_theory_gives() -> None:
    for series in SERIES:
        plan = full_stroke(series, QUICK)
        assert plan.frequencies == (15.0, 30.0, 60.0)
        response = respond(series.valve, "fluid", {}, plan)
        omega = 2.0 * np.pi * np.array(plan.frequencies)
        turns = np.exp(-1j * np.outer(omega, np.arange(plan.samples) / plan.sample_rate))
        relative = np.abs(np.mean(2.0 * (response.spool - response.body) * turns, axis=1)) / omega**2
        np.testing.assert_allclose(2.0 * relative, 9e-3, rtol=0.02)


def test_three_of_four_printed_objectives_of_model_3_are_above_those_of_the_model_it_contains() -> None:
    larger = [n for n in MODELS[2].objective if MODELS[2].objective[n] > MODELS[3].objective[n]]
    assert larger == [1, 2, 3]


def test_objective_as_printed_lets_errors_cancel() -> None:
    series = SERIES[0]
    made = respond(series.valve, "fluid", {}, QUICK)
    noise = np.random.default_rng(0).standard_normal(made.spool.shape)
    noisy = SteppedResponse(QUICK, made.body, made.spool + 0.5 * (noise - noise.mean()))
    found = fit(series, "fluid", noisy)
    assert abs(found.objective_as_printed) < 0.05 * found.objective


@pytest.mark.slow
def test_command_writes_a_page_that_stands_by_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduction, "LOCK_PLAN", LOCK)
    run_paper(tmp_path / "out", QUICKER)
    page = (tmp_path / "out" / "paper.html").read_text(encoding="utf-8")
    assert page.count('src="data:image/png;base64,') == 6
    assert not re.search(r"(src|href)=['\"](?!data:)", page)
    for said in ("measurements are not published", "Table 4 locks the spool", "model 4, h fitted"):
        assert said in page
    told = capsys.readouterr().out
    assert "in 4 of 4 series" in told
    written = json.loads((tmp_path / "out" / "paper.json").read_text(encoding="utf-8"))
    assert set(written["spool_follows_body_with_table_4"].values()) == {True}
    assert set(written["tables"]) == {
        "table_3", "table_4", "table_5", "table_6", "table_7", "objective_with_h_fitted", "derived",
        "models_in_both_regimes", "forces_in_both_regimes",
    }  # fmt: skip
    for row in written["tables"]["objective_with_h_fitted"]:
        for number in (1, 2, 3):
            free = row[f"model {number}, h fitted"]
            assert free <= 1.001 * row[f"model {number}, h = 15 µm"]
    for row in written["tables"]["objective_with_h_fitted"]:
        # Model 3 contains model 4, and so do those with h fitted.
        contained = 1.0001 * row["model 4, h fitted"]
        assert all(row[f"model {name} fitted"] <= contained for name in ("1, h", "2, h", "3, h"))
        assert row["model 3, h = 15 µm"] <= contained
    # The gap that model 1 has to keep is the reason why model 4 can win.
    assert row["model 1, h = 15 µm"] > row["model 4, h fitted"]
    forces = written["tables"]["forces_in_both_regimes"]
    small, large = forces[: len(SERIES)], forces[len(SERIES) :]
    assert all(row["stroke (mm)"] == pytest.approx(9.0, rel=0.03) for row in large)
    assert all(row["mean speed (m/s)"] > 0.5 for row in large)  # as the paper's conclusions have it
    assert all(row["fluid share of friction"] > 0.9 for row in large)
    assert all(row["fluid share of friction"] < 0.5 for row in small)
    with (tmp_path / "out" / "amplitudes.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(SERIES) * len(QUICKER.frequencies)
    assert all(float(row["body_m_s2"]) == pytest.approx(5.0, rel=0.06) for row in rows)
    # With table 4's values the spool is carried along by a body that moves.
    assert all(float(row["mixed_printed_values_m_s2"]) > 4.0 for row in rows)


def test_folder_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("", "utf-8")
    with pytest.raises(InputError, match="file: cannot be made"):
        run_paper(tmp_path / "file", QUICK)
    assert main(["paper", "--out", str(tmp_path / "file" / "below")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
