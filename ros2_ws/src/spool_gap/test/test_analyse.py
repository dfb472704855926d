from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity
from spool_estimator.identification.record import Record, records_from_blocks
from spool_gap.evidence.analyse import analyse
from spool_gap.likelihood.structure import structure_of
from spool_gap.report import lead, nothing_missing, result_to_dict, rounded, unnamed
from spool_gap.result import Explanation, GapResult, Remainder
from spool_sim.excitation import Multisine, SweptSine
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
#: Lengths of a record and of each of its sweeps, s. Slow tests take the long one. A sweep passes the jump of
#: a hardening spring once: in a short record the sweeps are quick, so that several of them show it.
SHORT, LONG = (8.0, 2.0), (24.0, 8.0)
Lengths = tuple[float, float]


def record(model: str = "fluid", lengths: Lengths = SHORT, seed: int = 1, **given: object) -> Record:
    spool = given.pop("spool", {})
    assert isinstance(spool, dict)
    seconds, duration = lengths
    sweep = SweptSine(start_frequency=6.0, stop_frequency=80.0, duration=duration, amplitude=9.0)
    simulator = Simulator(
        VALVE, sweep, model=model, parameters=given, sample_rate=1250.0, block_size=50, seed=seed,
        body_sensor=Sensor(noise=0.03), spool_sensor=Sensor(**{"noise": 0.03, **spool}),
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(seconds), f"hidden {model}")
    return found


@lru_cache
def healthy(lengths: Lengths = SHORT) -> Record:
    return record(lengths=lengths)


@lru_cache
def with_cubic(lengths: Lengths = SHORT) -> GapResult:
    hidden = record("fluid_cubic_stiffness", lengths, cubic_coefficient=4e7)
    return analyse([hidden], VALVE, MODELS["fluid"])


@lru_cache
def of_healthy() -> GapResult:
    return analyse([healthy()], VALVE, MODELS["fluid"])


def test_nothing_is_named_where_nothing_is_missing() -> None:
    result = of_healthy()
    assert result.verdict == "none"
    assert result.effects == ()
    assert result.nuisances == ()
    assert result.after.nrmse < 1.3 * result.noise_floor


@pytest.mark.parametrize("case", [of_healthy, with_cubic])
def test_the_structure_that_won_leads_the_ranking_and_others_have_a_reason(
    case: Callable[[], GapResult],
) -> None:
    result = case()
    first, *others = result_to_dict(result)["ranking"]
    assert (first["id"], first["accepted"]) == (result.verdict, True)
    assert first["evidence"] >= 0.0
    assert first["nrmse_after"] == pytest.approx(result.after.nrmse)
    assert not any(row["accepted"] for row in others)
    assert all(row["reason"] for row in others)


def test_explanations_are_the_effects_and_what_has_no_name() -> None:
    """Their probabilities sum to 1, however sure the verdict is."""
    for result in (with_cubic(), replace(with_cubic(), confidence=0.3)):
        first, last = sorted(result_to_dict(result)["explanations"], key=lambda row: -len(row["parameters"]))
        assert (first["effects"], first["group"]) == (["cubic_stiffness"], "spring and play")
        assert first["parameters"]["cubic_coefficient"]["value"] == pytest.approx(4e7, rel=0.03)
        assert first["probability"] == pytest.approx(result.confidence)
        assert (last["effects"], last["probability"]) == (
            ["unexplained"],
            pytest.approx(1.0 - result.confidence),
        )


def test_effects_that_a_record_does_not_tell_apart_share_the_confidence() -> None:
    other = Explanation(("spring_preload",), 0.25, told_apart_by="amplitudes")
    result = replace(with_cubic(), alternatives=(other,), confidence=0.8)
    shares = {one.effects: one.probability for one in result.explanations}
    assert shares == pytest.approx(
        {("cubic_stiffness",): 0.6, ("spring_preload",): 0.2, ("unexplained",): 0.2}
    )
    assert result.explanations[0].effects == ("cubic_stiffness",)
    assert result.explanations[0].told_apart_by


def test_noise_of_which_only_a_bound_is_known_is_left_out() -> None:
    result = replace(of_healthy(), noise_floor=0.09)
    assert result_to_dict(result)["gap"]["noise_floor"] is None
    assert nothing_missing("fluid", 0.004, 0.09, "the force") == (
        "Nothing is missing: 'fluid' leaves 0.40 % of the force."
    )


def test_a_report_leads_with_what_is_missing_how_sure_that_is_and_what_to_check() -> None:
    result = replace(with_cubic(), confidence=0.8)
    missing, sure, check = lead(result)
    assert missing == (
        "What is missing",
        f"The model lacks cubic stiffness (cubic coefficient {shown(result)}).",
    )
    assert sure[0] == "How sure"
    assert sure[1].startswith("Confidence 0.80; on data that no fit has seen: error ")
    assert check[0] == "What to check"
    assert check[1].lower() == f"{result.effects[0].check}.".lower()
    left = replace(result, remainder=Remainder(0.01, 9.0, "the motion of the body", "a lag"))
    assert "and something else is left (" in lead(left)[0][1]
    assert lead(left)[0][1].endswith("; it follows the motion of the body: a lag).")


def shown(result: GapResult) -> str:
    return rounded(result.effects[0].parameters[0])


@pytest.mark.parametrize(
    ("deviation", "text"), [(0.000018, "225.0 Hz"), (0.02, "225.0 Hz"), (0.3, "225.00 ± 0.59 Hz")]
)
def test_an_interval_below_four_digits_is_not_shown_in_sentences(deviation: float, text: str) -> None:
    assert rounded(Quantity("force_frequency", "Hz", 225.000018, deviation)) == text


def test_an_open_gap_is_told_with_the_candidate_and_what_is_left() -> None:
    text = unnamed("fluid", ["cubic_stiffness"], "speed", 0.1, 0.025, 0.01, "the force")
    assert text == (
        "Something is missing that has no name here: 'fluid' misses 10 % of the force, the best model 2.5 %, "
        "noise alone 1.0 %. Closest is cubic stiffness: with it 94 % of the difference's power is gone. "
        "The rest follows speed: friction or drag of another law."
    )


@pytest.mark.slow
def test_friction_of_two_directions_keeps_a_correlation_for_each_number() -> None:
    hidden = record("fluid_asymmetric_friction", (16.0, 8.0), seed=3, forward_force=0.2, backward_force=0.1)
    result = analyse([hidden], VALVE, MODELS["fluid"])
    assert result.verdict == "asymmetric_friction"
    assert {"forward_force", "backward_force"} <= set(result.correlated)
    assert result.correlation.shape == (len(result.correlated), len(result.correlated))
    np.testing.assert_allclose(np.diag(result.correlation), 1.0)
    forces = [q.value for q in result.parameters if q.name in ("forward_force", "backward_force")]
    # Their mean is what a moving spool shows.
    assert sum(forces) == pytest.approx(0.3, rel=0.02)


def test_a_hardening_spring_is_named_with_its_size_and_closes_the_gap() -> None:
    result = with_cubic()
    assert result.verdict == "cubic_stiffness"
    (effect,) = result.effects
    assert effect.parameters[0].value == pytest.approx(4e7, rel=0.03)
    assert result.after.nrmse < 0.2 * result.before.nrmse
    assert result.after.nrmse < 1.3 * result.noise_floor
    assert result.after.amplitude_ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_coulomb_friction_is_not_taken_for_a_confusable_effect() -> None:
    hidden = record("coulomb", LONG, coulomb_force=0.4)
    result = analyse([hidden], VALVE, MODELS["fluid"])
    assert result.verdict == "coulomb_friction"
    assert result.effects[0].parameters[0].value == pytest.approx(0.4, rel=0.03)
    assert {row.id for row in result.ranking} >= {"stribeck_friction", "mixed_friction"}
    written = result_to_dict(result)
    assert set(written["predictable_share"]) == set(result.predictable)
    assert [row["jointly_with"] for row in written["ranking"]] == [
        list(row.jointly_with) for row in result.ranking
    ]


@pytest.mark.slow
def test_the_gap_is_gone_where_the_saved_model_is_the_base() -> None:
    found = with_cubic(LONG)
    names = [entry.name for entry in found.model.terms]
    base = model_from_mapping({"name": "saved", "terms": names, "parameters": dict(found.model.values)})
    hidden = record("fluid_cubic_stiffness", LONG, seed=2, cubic_coefficient=4e7)
    assert analyse([hidden], VALVE, base).verdict == "none"


@pytest.mark.slow
def test_gain_within_its_tolerance_is_no_effect_and_beyond_it_is_one() -> None:
    within = record(lengths=LONG, spool={"gain_error": 0.03})
    beyond = record(lengths=LONG, spool={"gain_error": 0.09})
    assert analyse([within], VALVE, MODELS["fluid"]).verdict == "none"
    result = analyse([beyond], VALVE, MODELS["fluid"])
    assert result.verdict == "spool_gain_error"
    assert result.effects[0].parameters[0].value == pytest.approx(0.09, abs=0.01)


def test_a_channel_that_clips_is_named_and_its_limit_read() -> None:
    result = analyse([record(spool={"full_scale": 16.0})], VALVE, MODELS["fluid"])
    assert result.verdict == "sensor_saturation"
    assert result.effects[0].parameters[0].value == pytest.approx(16.0, rel=1e-3)


@pytest.mark.slow
def test_the_spools_limit_is_named_where_the_body_clips_too() -> None:
    whole = healthy(LONG)
    limit = float(np.quantile(np.abs(np.concatenate([whole.body, whole.spool])), 0.995))
    clipped = replace(
        whole, body=np.clip(whole.body, -limit, limit), spool=np.clip(whole.spool, -limit, limit)
    )
    result = analyse([clipped], VALVE, MODELS["fluid"])
    assert result.verdict.split("+")[0] == "sensor_saturation"
    assert result.effects[0].parameters[0].value == pytest.approx(limit, rel=1e-3)


@pytest.mark.slow
def test_another_record_can_be_held_out() -> None:
    other = record(lengths=(16.0, 8.0), seed=5)
    result = analyse([healthy(LONG)], VALVE, MODELS["fluid"], holdout=[other])
    assert result.verdict == "none"


def test_the_result_survives_json_and_pickle() -> None:
    result = with_cubic()
    plain = json.loads(json.dumps(result_to_dict(result), allow_nan=False))
    assert plain["verdict"] == "cubic_stiffness"
    assert set(plain["where"]) >= {"frequency", "displacement", "velocity", "time"}
    assert {"low_Hz", "high_Hz", "share"} <= set(plain["where"]["frequency"][0])
    assert plain["effects"][0]["parameters"]["cubic_coefficient"]["unit"] == "N/m^3"
    for row in ("frequency", "displacement", "velocity", "direction", "time", "phase"):
        assert sum(entry["share"] for entry in plain["where"][row]) == pytest.approx(1.0, abs=1e-6)
    assert pickle.loads(pickle.dumps(result)).verdict == result.verdict


@pytest.mark.slow
def test_the_same_record_gives_the_same_numbers() -> None:
    first, again = (analyse([healthy(LONG)], VALVE, MODELS["fluid"]) for _ in range(2))
    assert first.after == again.after
    assert first.parameters == again.parameters


def spoiled(**changes: object) -> Record:
    whole = healthy()
    body, spool = np.array(changes.get("body", whole.body)), np.array(changes.get("spool", whole.spool))
    return Record("spoiled", 0, float(changes.get("period", whole.sample_period)), body, spool)


def test_a_bad_record_is_refused_in_words() -> None:
    whole = healthy()
    noise = 0.03 * np.random.default_rng(0).standard_normal(whole.body.size)
    cases = {
        "too short": whole.part(0, 5000),
        "spool reads 0 m/s": spoiled(spool=np.zeros(whole.body.size)),
        "no excitation": spoiled(body=noise, spool=noise[::-1].copy()),
        "only noise": spoiled(spool=noise),
        "exchanged": spoiled(body=whole.spool, spool=whole.body),
        "9.81": spoiled(spool=whole.spool / 9.80665),
        "too slow": spoiled(period=whole.sample_period * 10.0),
    }
    for words, bad in cases.items():
        with pytest.raises(InputError, match=words):
            analyse([bad], VALVE, MODELS["fluid"])


def test_coefficients_that_count_per_weight_take_that_of_the_valves_spool() -> None:
    light = VALVE.model_copy(update={"spool_mass": 0.12})
    assert structure_of(MODELS["fluid"], light).values["normal_load"] == pytest.approx(0.12 * 9.80665)


@pytest.mark.parametrize("share", [pytest.param(0.6, marks=pytest.mark.slow), 0.3])
def test_a_record_whose_channels_clip_all_the_time_is_refused_with_a_way_out(share: float) -> None:
    whole = healthy()
    body, spool = (np.clip(row, -share * row.std(), share * row.std()) for row in (whole.body, whole.spool))
    with pytest.raises(InputError, match=r"hardly a second .* choose a larger range of the sensor"):
        analyse([replace(whole, body=body, spool=spool)], VALVE, MODELS["fluid"])


@pytest.mark.slow
def test_hits_on_a_stop_are_no_noise_that_hides_what_is_missing() -> None:
    hard = {"stop_gap": 0.0006, "stop_stiffness": 2e5}
    simulator = Simulator(
        VALVE, Multisine(low_frequency=8.0, high_frequency=90.0, rms=7.0, seed=2), model="fluid_end_stop",
        parameters=hard, sample_rate=1000.0, seed=3, body_sensor=Sensor(noise=0.03),
        spool_sensor=Sensor(noise=0.03),
    )  # fmt: skip
    rows = [(block.body, block.spool) for block in simulator.records(24.0)]
    body, spool = (np.concatenate(row).astype(np.float64) for row in zip(*rows, strict=True))
    found = analyse([Record("stops", 0, 1e-3, body, spool)], VALVE, MODELS["fluid"])
    assert not found.noise_floor > 0.2  # NaN where only a bound is known
    assert set(found.verdict.split("+")) <= {"end_stop", "unexplained"}
