from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.uncertainty import rate_power
from spool_estimator.identification.fit import fit, free_run_agreement
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, FitSettings
from spool_estimator.identification.record import Record, first_seconds, records_from_blocks
from spool_estimator.identification.residuals import covariance_of
from spool_estimator.identification.spectra import ZeroPhase, relative_motion
from spool_sim.excitation import Excitation, Multisine, SweptSine
from spool_sim.integration.composed_motion import ComposedMotion
from spool_sim.model import MODELS
from spool_sim.observation import INSTANTS, Observation
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

SWEEP = SweptSine(start_frequency=8.0, stop_frequency=100.0, duration=5.0, amplitude=10.0, soft_start=0.2)
#: The simulated sensors sample at one instant.
EXACT = FitSettings(timing=0.0)


@pytest.fixture(scope="module")
def valve() -> Valve:
    return find_valve("4weh10_soft")


def record(
    valve: Valve,
    model: str,
    truth: Mapping[str, float],
    *,
    noise: float = 0.05,
    seconds: float = 10.0,
    drive: Excitation = SWEEP,
    spool: Sensor | None = None,
    rate: float = 2000.0,
) -> Record:
    simulator = Simulator(
        valve,
        drive,
        model=model,
        parameters=truth,
        sample_rate=rate,
        seed=3,
        body_sensor=Sensor(noise=noise),
        spool_sensor=spool or Sensor(noise=noise),
    )
    (whole,) = records_from_blocks(simulator.records(seconds), model)
    return whole


@settings(max_examples=20)
@given(st.lists(st.floats(-100.0, 100.0), min_size=3, max_size=9))
def test_few_blocks_tell_a_mean_with_the_variance_of_students_t(sums: list[float]) -> None:
    count = len(sums)
    spread = float(np.var(sums, ddof=1))
    assume(spread > 1.0)
    blocks = [slice(number, number + 1) for number in range(count)]
    (variance,) = covariance_of(np.ones((count, 1)), np.array(sums), blocks)[0].ravel()
    assert variance == pytest.approx(spread / count * (1.0 + 2.0 / count))


def test_integration_without_phase_keeps_a_sine_and_drops_bias_and_drift() -> None:
    t = np.arange(8000) / 2000.0
    turn = 2.0 * math.pi * 20.0
    spool = 10.0 * np.sin(turn * t) + 3.0 + 0.5 * t
    motion = relative_motion(np.zeros(t.size), spool, ZeroPhase(1.0 / 2000.0, 3.0))
    inside = slice(4 * motion.settling, -4 * motion.settling)
    np.testing.assert_allclose(
        motion.velocity[inside], -10.0 / turn * np.cos(turn * t[inside]), atol=1e-3 * 10.0 / turn
    )
    np.testing.assert_allclose(
        motion.displacement[inside], -10.0 / turn**2 * np.sin(turn * t[inside]), atol=2e-3 * 10.0 / turn**2
    )


def test_a_gap_in_the_stream_separates_two_records(valve: Valve) -> None:
    blocks = list(Simulator(valve, SWEEP, model="fluid", block_size=200).records(2.0))
    stretches = records_from_blocks(blocks[:8] + blocks[10:], "with a gap")
    assert [stretch.body.size for stretch in stretches] == [1600, 2000]
    assert stretches[1].first_sample == 2000
    whole = records_from_blocks(blocks, "whole")[0]
    np.testing.assert_array_equal(stretches[1].spool, whole.part(2000, 4000).spool)
    assert whole.part(2000, 4000).first_sample == 2000


@given(
    rate=st.one_of(st.integers(100, 6000), st.floats(90.0, 6000.0)),
    lengths=st.lists(st.integers(1, 60_000), min_size=1, max_size=4),
    seconds=st.floats(0.5, 20.0),
)
@settings(max_examples=200, deadline=None)
def test_the_first_seconds_of_records_are_whole_samples_at_any_rate(
    rate: float, lengths: list[int], seconds: float
) -> None:
    records = [Record("r", 1, 1.0 / rate, row, row) for row in (np.zeros(length) for length in lengths)]
    parts = list(first_seconds(records, seconds))
    assert all(part.body.size >= 1 for _, part in parts)
    assert [number for number, _ in parts] == list(range(len(parts)))
    taken = sum(part.body.size for _, part in parts)
    assert abs(taken - min(sum(lengths), seconds * rate)) <= 0.5 + 1e-6 * taken


@pytest.mark.parametrize("rate", [833.0, 333.0, 100.055, 2000.0 * (1.0 - 10e-6), 2000.0 * (1.0 + 37e-6)])
def test_a_record_at_a_measured_rate_is_fitted_with_a_gap_in_it(rate: float, valve: Valve) -> None:
    truth = {"spring_stiffness": 1700.0, "viscous_coefficient": 5.0}
    drive = Multisine(low_frequency=5.0, high_frequency=30.0, rms=6.0)
    whole = record(valve, "fluid", truth, seconds=10.0, drive=drive, rate=rate)
    stretches = [whole.part(0, round(8.0 * rate)), whole.part(round(8.02 * rate), whole.body.size)]
    result = fit(stretches, MODELS["fluid"], valve, EXACT)
    assert result.reason is None
    for name, value in truth.items():
        assert result.parameter(name).value == pytest.approx(value, rel=0.01)


@pytest.mark.parametrize("name", ["coulomb", "mixed", "fluid_presliding_friction", "fluid_end_stop"])
def test_forces_at_given_motion_are_those_of_the_terms(name: str, valve: Valve) -> None:
    model = MODELS[name]
    motion = ComposedMotion(model.terms)
    values = model.values_for(valve)
    t = np.arange(500) / 2000.0
    z: NDArray[np.float64] = 5e-3 * np.sin(2.0 * math.pi * 11.0 * t)
    v: NDArray[np.float64] = np.gradient(z, t)
    expected = sum(
        entry.force(z, v, np.zeros(t.size), values, t) for entry in model.terms if entry.name != "inertia"
    )
    given = np.array([[values[parameter] for parameter in motion.names]])
    np.testing.assert_allclose(
        motion.forces(z, v, given, sample_period=1.0 / 2000.0)[0], expected, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("name", ["fluid", "coulomb", "mixed"])
def test_the_true_parameters_run_free_give_the_record(name: str, valve: Valve) -> None:
    truth = MODELS[name].values_for(valve)
    exact = record(valve, name, truth, noise=0.0, seconds=5.0)
    # The simulated sensors sample at instants.
    agreement = free_run_agreement([exact], MODELS[name], valve, truth, observation=Observation(INSTANTS))
    assert agreement.nrmse < 1e-5
    assert agreement.amplitude_ratio == pytest.approx(1.0, abs=1e-3)


def test_a_fit_finds_the_parameters_within_its_standard_deviations(valve: Valve) -> None:
    truth = {"spring_stiffness": 1700.0, "viscous_coefficient": 5.0, "coulomb_force": 0.4}
    result = fit([record(valve, "coulomb", truth)], MODELS["coulomb"], valve, EXACT)
    assert result.reason is None
    assert result.converged
    assert result.agreement is not None
    assert result.agreement.amplitude_ratio == pytest.approx(1.0, abs=0.01)
    for name, value in truth.items():
        found = result.parameter(name)
        assert abs(found.value - value) < 4.0 * found.standard_deviation
        assert found.value == pytest.approx(value, rel=0.01)
    np.testing.assert_allclose(np.diag(result.correlation), 1.0)
    assert result.held["mass"] == valve.moving_mass


def test_gain_and_delay_of_a_sensor_are_found_beside_the_parameters(valve: Valve) -> None:
    truth = {"spring_stiffness": 1632.0, "viscous_coefficient": 6.0}
    wrong = Sensor(noise=0.05, gain_error=0.03, delay_samples=2.4)
    data = record(valve, "fluid", truth, spool=wrong)
    result = fit([data], MODELS["fluid"], valve, FitSettings(fit_gain=True, fit_delay=True))
    assert result.parameter(SPOOL_GAIN).value == pytest.approx(0.03, abs=0.003)
    assert result.parameter(SPOOL_DELAY).value == pytest.approx(2.4 * 5e-4, abs=2e-5)
    assert result.parameter("viscous_coefficient").value == pytest.approx(6.0, rel=0.02)


def test_a_load_and_its_coefficients_are_told_as_products_only(valve: Valve) -> None:
    data = record(valve, "mixed", {"normal_load": 2.0, "mixed_inverse_coefficient": 0.008})
    result = fit(
        [data],
        MODELS["mixed"],
        valve,
        FitSettings(free=("normal_load",), held={"mixed_velocity": 0.01}, timing=0.0),
    )
    assert result.reason is None
    lost = {"normal_load", "mixed_root_coefficient", "mixed_inverse_coefficient"}
    assert set(result.not_observable) == lost
    assert all(math.isnan(result.parameter(name).value) for name in lost)
    product = next(
        entry for entry in result.combinations
        if set(entry.name.split("*")) == {"normal_load", "mixed_inverse_coefficient"}
    )  # fmt: skip
    assert product.value == pytest.approx(0.016, rel=0.03)


def test_negative_damping_of_a_film_is_told_as_part_of_the_drag_only(valve: Valve) -> None:
    truth = {"viscous_coefficient": 6.0, "film_coefficient": 0.3, "film_drag": valve.viscous_coefficient}
    data = record(valve, "coulomb_hydrodynamic", truth)
    result = fit([data], MODELS["coulomb_hydrodynamic"], valve, EXACT)
    assert set(result.not_observable) == {"viscous_coefficient", "film_coefficient"}
    together = result.parameter("viscous_coefficient - film_coefficient*film_drag")
    assert together.value == pytest.approx(6.0 - 0.3 * valve.viscous_coefficient, rel=0.01)


def test_friction_at_rest_is_not_told_by_a_spool_that_never_rests(valve: Valve) -> None:
    result = fit([record(valve, "fluid", {})], MODELS["microwedge"], valve, EXACT)
    assert "contact_proportionality" in result.not_observable
    assert not result.combinations


@pytest.mark.parametrize("velocity", [0.02, 0.05])
def test_friction_that_falls_with_speed_is_found_from_the_usual_start(velocity: float, valve: Valve) -> None:
    truth = {"coulomb_force": 0.1, "static_force": 0.16, "stribeck_velocity": velocity}
    drive = Multisine(low_frequency=6.0, high_frequency=100.0, rms=6.0)
    result = fit(
        [record(valve, "stribeck", truth, drive=drive, noise=0.03)], MODELS["stribeck"], valve, EXACT
    )
    for name, true in truth.items():
        one = result.parameter(name)
        assert abs(one.value - true) < 3.0 * one.standard_deviation < true, one


def test_the_information_criterion_prefers_the_law_that_is_there(valve: Valve) -> None:
    data = record(
        valve,
        "coulomb",
        {"coulomb_force": 0.2},
        seconds=6.0,
        drive=Multisine(low_frequency=8.0, high_frequency=90.0, rms=6.0),
    )
    criteria = {
        name: fit([data], MODELS[name], valve, EXACT).information_criterion
        for name in ("fluid", "coulomb", "fluid_quadratic_damping")
    }
    assert min(criteria, key=lambda name: criteria[name]) == "coulomb"


def test_a_record_that_cannot_be_fitted_gives_a_reason(valve: Valve) -> None:
    data = record(valve, "fluid", {}, seconds=2.0)
    short = fit([data.part(0, 400)], MODELS["fluid"], valve)
    assert short.reason is not None
    assert "a fit needs more than" in short.reason
    dead = Record("dead", data.start, data.sample_period, data.body, np.zeros(data.body.size))
    silent = fit([dead], MODELS["fluid"], valve)
    assert silent.reason is not None
    assert "check the sensor" in silent.reason
    with pytest.raises(InputError, match="sample 7 is not a number"):
        Record("broken", 1, 1e-3, np.zeros(10), np.where(np.arange(10) == 7, np.nan, 0.0))


def test_what_is_not_known_of_the_rate_enters_each_parameter_by_its_power(valve: Valve) -> None:
    truth = {"viscous_coefficient": 6.0, "coulomb_force": 0.4}
    whole = record(valve, "coulomb", truth, seconds=8.0)
    exact = {one.name: one for one in fit([whole], MODELS["coulomb"], valve, EXACT).parameters}
    slower = replace(whole, sample_period=whole.sample_period / 0.99)
    moved = {one.name: one for one in fit([slower], MODELS["coulomb"], valve, EXACT).parameters}
    unsure = replace(whole, rate_std=0.01)
    wide = {one.name: one for one in fit([unsure], MODELS["coulomb"], valve, EXACT).parameters}
    for name, power in (("spring_stiffness", 2), ("viscous_coefficient", 1), ("coulomb_force", 0)):
        one = exact[name]
        assert rate_power(one.unit) == power
        assert moved[name].value == pytest.approx(one.value * 0.99**power, rel=0.01)
        added = math.sqrt(wide[name].standard_deviation ** 2 - one.standard_deviation**2)
        assert wide[name].value == one.value
        assert added == pytest.approx(0.01 * power * one.value, abs=0.05 * one.standard_deviation)
