from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_estimator.identification.free_run import USUAL
from spool_estimator.identification.record import Record
from spool_report.fit_curves import overlay, sensor_noise
from spool_report.ranking import (
    WORTH,
    FittedSeries,
    Rank,
    away_from_jumps,
    fit_and_validate,
    no_worse,
    ordered,
    rank,
)
from spool_report.records.record_loading import load_data, load_recording
from spool_report.requests import Selection
from spool_sim.excitation import SteadySine
from spool_sim.model import load_model
from spool_sim.observation import INSTANTS, Observation
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

BAGS = Path(__file__).resolve().parents[4] / "bags"


def entry(model: str, parameters: int, error: float, criterion: float = 0.0) -> Rank:
    return Rank(model, parameters, criterion, error, math.nan, 1.0, 1.0, 0.1, 0.1, None)


def test_of_models_that_do_equally_well_the_smallest_is_preferred() -> None:
    ranking = ordered([entry("stribeck", 5, 1.0), entry("coulomb", 3, 1.02), entry("fluid", 2, 3.0)])
    assert [one.model for one in ranking.ranks] == ["coulomb", "stribeck", "fluid"]
    assert ranking.preferred == "coulomb"
    assert ranking.equal == ("stribeck",)
    assert ranking.sentences[0] == (
        "coulomb is preferred: the next different model, fluid, leaves 2.9 times as much error."
    )
    assert "stribeck fits equally well with 2 more parameters" in ranking.sentences[1]


def test_a_larger_model_that_is_worth_its_parameters_is_preferred() -> None:
    ranking = ordered([entry("stribeck", 5, 1.0), entry("coulomb", 3, 1.05)])
    assert ranking.preferred == "stribeck"
    assert ranking.sentences == (
        "stribeck is preferred: the next different model, coulomb, leaves 5 % more error.",
    )


def test_a_law_whose_numbers_make_no_sense_is_behind_those_that_it_would_beat() -> None:
    odd, mixed = (entry("stribeck", 5, 0.06), entry("mixed", 5, 0.09))
    odd, mixed = replace(odd, doubt="no excess at rest"), replace(mixed, doubt="no film")
    ranking = ordered([odd, entry("coulomb", 3, 0.08), mixed])
    assert [one.model for one in ranking.ranks] == ["coulomb", "mixed", "stribeck"]
    assert [round(one.excess, 3) for one in ranking.ranks] == [0.0, 0.125, -0.25]
    assert ranking.preferred == "coulomb"
    assert ranking.sentences[-1] == (
        "stribeck leaves 25 % less error, but its numbers make no sense on a machine: no excess at rest."
    )
    assert ordered([odd, mixed]).preferred == "stribeck"


def test_the_friction_of_a_record_behind_a_logger_s_filter_is_not_said_to_fall_with_speed() -> None:
    """Stribeck's law with less force at rest than at speed imitates what the filter's shape leaves."""
    data = load_data([BAGS / "practice_03"], "4weh10_soft", Selection(stop=15.0))
    fits = tuple(
        fit_and_validate(data, load_model(name), FitSettings(fit_gain=True, fit_delay=True))
        for name in ("coulomb", "stribeck")
    )
    ranking = rank([FittedSeries(data, fits)])
    assert ranking.preferred == "coulomb"
    assert "stribeck leaves" in ranking.sentences[-1]


def test_twins_are_not_distinguished() -> None:
    ranking = ordered([entry("a_law", 3, 1.0), entry("another", 3, 1.01), entry("worse", 3, 1.2)])
    assert ranking.sentences[0].startswith("a law and another cannot be distinguished on these data")


def test_a_certain_but_small_gain_is_told_and_not_preferred() -> None:
    ranking = ordered([entry("fluid", 2, 1.01, -100.0), entry("coulomb", 3, 1.0, -150.0)])
    assert ranking.preferred == "fluid"
    assert any(
        "prefers coulomb, by 50; coulomb reduces the error by only 1.0 %" in s for s in ranking.sentences
    )


def test_a_criterion_that_prefers_a_worse_model_is_explained_and_ranks_nothing() -> None:
    ranking = ordered([entry("coulomb", 3, 1.0, 1353.0), entry("stribeck", 5, 3.5, 0.0)])
    assert ranking.preferred == "coulomb"
    assert ranking.sentences[1].endswith(
        "prefers stribeck, by 1353; stribeck does not reduce the error, and the error decides."
    )
    assert len(ordered([entry("a", 3, 1.0, 1.0), entry("b", 4, 1.0, 0.0)]).sentences) == 2


def test_a_model_that_contains_another_is_fitted_no_worse() -> None:
    data = load_data([BAGS / "practice_03"], "4weh10_soft", Selection(stop=12.0))
    settings = FitSettings(starts=1)
    dry = fit_and_validate(data, load_model("coulomb"), settings)
    # Held at more friction than there is, as a descent may end beside its optimum.
    wrong = replace(settings, held={"coulomb_force": 0.8, "static_force": 0.8})
    beside = fit_and_validate(data, load_model("stribeck"), wrong)
    assert beside.training_error > 1.5 * dry.training_error
    beside = replace(beside, fit=replace(beside.fit, held={"mass": beside.fit.held["mass"]}))
    found = no_worse(data, [beside, dry], settings)
    assert [one.name for one in found] == ["stribeck", "coulomb"]
    assert found[0].training_error <= 1.001 * dry.training_error


def test_a_model_without_a_result_comes_last_with_its_reason() -> None:
    lost = replace(entry("broken", 3, math.nan, math.nan), reason="it broke")
    ranking = ordered([lost, entry("fluid", 2, 1.0)])
    assert [one.model for one in ranking.ranks] == ["fluid", "broken"]
    assert ranking.sentences[-1] == "broken has no result: it broke."
    assert ordered([lost]).preferred is None


def test_what_none_of_the_models_explains_is_said() -> None:
    ranks = [entry("fluid", 2, 0.5), entry("coulomb", 3, 0.2)]
    assert len(ordered(ranks, noise=0.1).sentences) == 1
    said = ordered(ranks, noise=0.05).sentences[1]
    assert said.startswith("Even coulomb leaves 4.0 times the noise of the spool's sensor")


def test_a_descent_that_did_not_converge_is_named() -> None:
    ranking = ordered([entry("fluid", 2, 0.5), entry("coulomb", 3, 0.2)], unsure={"fluid"})
    assert ranking.sentences[-1] == "fluid did not converge: might do better."


@pytest.mark.parametrize("name", ["practice_01", "practice_03", "practice_04"])
def test_the_noise_is_not_taken_for_less_than_it_is(name: str) -> None:
    """The records' README states 0.03 m/s^2 for all; dry friction's harmonics may be taken for noise."""
    (stretch,) = load_recording(BAGS / name).stretches
    assert 0.028 < sensor_noise([stretch]) < 0.1


@given(
    entries=st.lists(
        st.tuples(st.integers(1, 6), st.floats(0.01, 100.0) | st.just(math.nan)), min_size=1, max_size=8
    )
)
def test_no_smaller_model_does_as_well_as_the_preferred(entries: list[tuple[int, float]]) -> None:
    ranks = [entry(f"model_{n}", count, error) for n, (count, error) in enumerate(entries)]
    one, other = ordered(ranks), ordered(ranks[::-1])
    assert [r.error for r in one.ranks if not math.isnan(r.error)] == pytest.approx(
        [r.error for r in other.ranks if not math.isnan(r.error)]
    )
    best = one.ranks[0]
    if one.preferred is not None:
        for rank in one.ranks[1:]:
            assert math.isnan(rank.error) or rank.excess > WORTH or rank.parameters >= best.parameters


def test_samples_at_instants_beside_reversals_are_left_out_for_all_alike() -> None:
    """At 20 Hz the spool reverses 40 times a second, each time between two samples."""
    valve = find_valve("4weh10_soft")
    simulator = Simulator(
        valve, SteadySine(frequency=20.0, amplitude=10.0), model="coulomb", coulomb_force=0.3
    )
    blocks = list(simulator.records(6.0))
    made = Record(
        "made", 0, simulator.sample_period,
        np.concatenate([block.body for block in blocks]).astype(np.float64),
        np.concatenate([block.spool for block in blocks]).astype(np.float64),
    )  # fmt: skip
    dry = load_model("coulomb")
    values = dry.values_for(valve, {"coulomb_force": 0.3})
    instants = Observation(INSTANTS)
    truth = overlay([made], Fit(dry, valve.id, values=values, observation=instants), valve)
    filtered = overlay([made], Fit(dry, valve.id, values=values, observation=USUAL), valve)
    smooth = load_model("fluid")
    wrong = overlay([made], Fit(smooth, valve.id, values=smooth.values_for(valve)), valve)
    kept = away_from_jumps([wrong, truth, None])
    total = sum(row.size for row in kept)
    left_out = total - sum(int(row.sum()) for row in kept)
    reversals = 40.0 * total * simulator.sample_period
    assert left_out == pytest.approx(2.0 * reversals, rel=0.05)
    # What fits best says where; without dry friction nothing jumps, and a filter is part of the model.
    assert all(row.all() for run in (wrong, filtered) for row in away_from_jumps([run]))
