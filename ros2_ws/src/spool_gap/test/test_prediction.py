"""Prediction errors: noise under the truth, numbers recovered from afar, missing samples in both roles."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from spool_estimator.identification.record import Record
from spool_estimator.identification.signals.spectra import delayed
from spool_gap.likelihood.chain_part import CHAIN_PARTS, inverse
from spool_gap.likelihood.prediction import Prediction, Structure, structure_of
from spool_gap.likelihood.readings import readings_of
from spool_gap.likelihood.structure_fit import StructureFit, fit_structure
from spool_gap.workflow.preparation import motions_for
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve.description import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
MOTIONS = motions_for(BASE)
NOISE = 0.03
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=6.0, amplitude=9.0)


@lru_cache
def record(effect: str = "", seconds: float = 12.0, **given: float) -> Record:
    terms = () if not effect else (term(effect),)
    simulator = Simulator(
        VALVE, SWEEP, model=Model("hidden", (*BASE.terms, *terms), {}), parameters=given,
        sample_rate=1000.0, block_size=50, seed=5,
        body_sensor=Sensor(noise=NOISE), spool_sensor=Sensor(noise=NOISE),
    )  # fmt: skip
    blocks = list(simulator.records(seconds))
    body = np.concatenate([block.body for block in blocks]).astype(np.float64)
    spool = np.concatenate([block.spool for block in blocks]).astype(np.float64)
    return Record(effect, 0, blocks[0].sample_period, body, spool)


def with_play() -> Record:
    return record("spring_backlash", backlash=2e-4)


def prediction(of: Record, missing: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None) -> Prediction:
    return Prediction(readings_of(of, missing=missing), VALVE, MOTIONS)


def fitted(of: Record, *effects: str, **start: float) -> StructureFit:
    return fit_structure(prediction(of), structure_of(VALVE, effects, (), start))


def error_rms(one: Prediction, structure: Structure, looseness: float = 0.01) -> float:
    """Return the rms of the prediction errors within the band, m/s^2, as if it were the whole band."""
    lines = one.errors([structure], looseness).lines[0][1:-1]
    window = round(1.0 / one.period)
    return float(np.sqrt(np.mean(np.abs(lines) ** 2) / (0.9375 * window)))


def test_the_truth_leaves_the_noise_of_both_sensors() -> None:
    # Where the spool follows the body by |H|, the noises add up to sqrt(1 + |H|^2) times that of one sensor.
    left = error_rms(prediction(record()), structure_of(VALVE))
    assert NOISE * 0.97 < left < NOISE * 1.5


def test_the_truth_leaves_noise_where_the_motion_is_sensitive_to_its_start() -> None:
    one = prediction(with_play())
    truth = structure_of(VALVE, ("spring_backlash",), (), {"backlash": 2e-4})
    assert error_rms(one, truth) < 1.6 * NOISE
    assert error_rms(one, structure_of(VALVE)) > 10.0 * NOISE


def test_play_is_found_from_half_of_it() -> None:
    fit = fitted(with_play(), "spring_backlash", backlash=1e-4)
    assert fit.structure.values["backlash"] == pytest.approx(2e-4, rel=0.01)
    assert fit.structure.values["spring_stiffness"] == pytest.approx(VALVE.spring_stiffness, rel=2e-3)


@pytest.mark.parametrize(
    ("effect", "true", "start"),
    [
        ("coulomb_friction", {"coulomb_force": 0.4}, {"coulomb_force": 0.25}),
        ("cubic_stiffness", {"cubic_coefficient": 8e7}, {"cubic_coefficient": 4e7}),
        ("quadratic_damping", {"quadratic_coefficient": 20.0}, {"quadratic_coefficient": 10.0}),
        (
            "spring_preload",
            {"preload_force": 0.4, "preload_travel": 2e-5},
            {"preload_force": 0.2, "preload_travel": 4e-5},
        ),
    ],
)
def test_numbers_are_recovered_from_half_of_them(
    effect: str, true: dict[str, float], start: dict[str, float]
) -> None:
    fit = fitted(record(effect, **true), effect, **start)
    first = next(iter(true))
    assert fit.structure.values[first] == pytest.approx(true[first], rel=0.02)


def test_the_effect_that_acts_is_more_likely_than_another_one() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    right = fitted(of, "coulomb_friction", coulomb_force=0.2)
    others = [fitted(of), fitted(of, "quadratic_damping"), fitted(of, "cubic_stiffness")]
    assert right.evidence > max(one.evidence for one in others) + 100.0


def test_an_effect_that_does_not_act_costs_more_than_it_explains() -> None:
    of = record()
    assert fitted(of).evidence > fitted(of, "cubic_stiffness", cubic_coefficient=1e6).evidence


def test_gain_and_delay_of_the_spools_channel_are_recovered() -> None:
    of = record()
    late = replace(of, spool=1.02 * delayed(of.spool, 2e-4, of.sample_period))
    values = fitted(late).structure.values
    assert values["spool_gain_error"] == pytest.approx(0.02, abs=2e-3)
    assert values["spool_delay"] == pytest.approx(2e-4, abs=1e-5)


def test_the_likelihood_is_the_same_for_sensors_that_are_both_turned_round() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    structure = structure_of(VALVE, ("coulomb_friction",), (), {"coulomb_force": 0.4})
    found = []
    for sign in (1.0, -1.0):
        one = prediction(replace(of, body=sign * of.body, spool=sign * of.spool))
        found.append(one.log_likelihood(one.errors([structure], 0.1).lines[0]))
    assert found[0] == pytest.approx(found[1], abs=1.0)


def test_a_clipped_excitation_counts_as_missing() -> None:
    of = with_play()
    limit = 0.9 * float(np.abs(of.body).max())
    one = prediction(replace(of, body=np.clip(of.body, -limit, limit)))
    truth = structure_of(VALVE, ("spring_backlash",), (), {"backlash": 2e-4})
    assert one.numbers < 0.97 * prediction(of).numbers
    assert error_rms(one, truth) < 2.0 * NOISE


def test_spikes_that_are_missing_leave_no_trace() -> None:
    of = record("coulomb_friction", coulomb_force=0.4)
    gone = np.zeros(of.spool.size, dtype=np.bool_)
    gone[500::700] = True
    nothing = np.zeros_like(gone)
    spiked = replace(of, spool=np.where(gone, 500.0, of.spool))
    truth = structure_of(VALVE, ("coulomb_friction",), (), {"coulomb_force": 0.4})
    assert error_rms(prediction(spiked, (nothing, gone)), truth) < 1.5 * NOISE


@pytest.mark.parametrize("key", [key for key, part in CHAIN_PARTS.items() if part.response is not None])
def test_a_part_of_the_chain_without_size_does_nothing(key: str) -> None:
    part = CHAIN_PARTS[key]
    assert part.response is not None
    values = {p.name: p.start for p in part.parameters} | {part.parameters[0].name: 0.0}
    frequency = np.linspace(1.0, 400.0, 100)
    assert part.response(frequency, values) == pytest.approx(1.0)


@pytest.mark.parametrize("key", ["body_ac_coupling", "spool_ac_coupling"])
def test_the_high_pass_of_a_channel_is_found_with_its_corner(key: str) -> None:
    of, part = record(), CHAIN_PARTS[key]
    assert part.response is not None
    size = part.parameters[0].name
    true = 0.8
    row = of.body if part.channel == "body" else of.spool
    lines = np.fft.rfft(row)
    frequency = np.maximum(np.fft.rfftfreq(row.size, of.sample_period), 1e-3)
    filtered = np.fft.irfft(lines * part.response(frequency, {size: true}), row.size)
    changed = replace(of, body=filtered) if part.channel == "body" else replace(of, spool=filtered)
    one = prediction(changed)
    found = fit_structure(one, structure_of(VALVE, (), (key,)))
    assert found.structure.values[size] == pytest.approx(true, rel=0.1)
    assert found.evidence > fit_structure(one, structure_of(VALVE)).evidence


def test_the_inverse_of_a_response_undoes_it_where_that_is_not_small() -> None:
    part = CHAIN_PARTS["spool_extra_mode"]
    assert part.response is not None
    values = {p.name: p.start for p in part.parameters}
    response = part.response(np.linspace(1.0, 400.0, 200), values)
    assert response * inverse(response) == pytest.approx(1.0)
