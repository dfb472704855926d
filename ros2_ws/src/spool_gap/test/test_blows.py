"""A spool that sticks between blows to its machine: spikes, friction by direction, what the search finds."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.identification.nuisances import spikes_of
from spool_estimator.identification.record import Record, records_from_blocks
from spool_gap.likelihood.kernel import motions_for
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.readings import readings_of
from spool_gap.likelihood.rest import two_forces
from spool_gap.likelihood.search import Search
from spool_gap.likelihood.structure import structure_of
from spool_gap.likelihood.structure_fit import fit_structure
from spool_sim.excitation import Recorded
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
BASE = MODELS["fluid"]
MOTIONS = motions_for(BASE)
SECONDS, RATE, NOISE, FORCE = 7.0, 4000.0, 0.02, 0.5


@lru_cache
def blows() -> Array:
    """Return blows to one side, half a sine of 8 ms each, m/s^2; the first comes after 0.3 s."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    draw = np.random.default_rng(4)
    starts = 0.3 + np.cumsum(draw.uniform(0.15, 0.4, 30))
    body = np.zeros(time.size)
    for start, height in zip(starts.tolist(), draw.uniform(10.0, 40.0, starts.size).tolist(), strict=True):
        share = (time - start) / 0.008
        body += height * np.where((share > 0.0) & (share < 1.0), np.sin(np.pi * share), 0.0)
    return body


@lru_cache
def hit(effect: str, **given: float) -> Record:
    sensor, model = Sensor(noise=NOISE), Model("hit", (*BASE.terms, term(effect)), {})
    simulator = Simulator(
        VALVE, Recorded(sample_rate=RATE, samples=blows()), model=model,
        parameters=given, sample_rate=RATE, block_size=200, seed=3, body_sensor=sensor, spool_sensor=sensor,
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(SECONDS), "hit")
    return found


def predictions(of: Record) -> Predictions:
    return Predictions([Prediction(readings_of(of), VALVE, MOTIONS)])


def test_the_bend_where_a_blow_begins_is_no_spike_and_a_spike_is_one() -> None:
    body = hit("coulomb_friction", coulomb_force=FORCE).body.copy()
    assert spikes_of(body, RATE) == []
    places = [900, 12_345, 20_001]
    body[places] += 3.0
    assert [place for place, _ in spikes_of(body, RATE)] == places


@pytest.mark.parametrize(("forward", "backward"), [(0.5, 0.5), (0.6, 0.4), (0.4, 0.6)])
def test_blows_to_one_side_are_no_friction_that_differs_by_direction(forward: float, backward: float) -> None:
    of = hit("asymmetric_friction", forward_force=forward, backward_force=backward)
    mean = structure_of(BASE, VALVE, ["coulomb_friction"], (), {"coulomb_force": FORCE})
    fit = fit_structure(predictions(of), mean)
    found = two_forces([readings_of(of)], VALVE, MOTIONS, fit)
    if forward == backward:
        assert found is None
    else:
        assert found is not None
        assert found.ratio == pytest.approx((forward - backward) / (forward + backward), abs=0.05)


def shaken(**given: float) -> Record:
    """Return a record that rests for 0.3 s, is then shaken at 14 Hz, the more for half a second."""
    rate, seconds = 2000.0, 4.0
    time = np.arange(round(seconds * rate)) / rate - 0.3
    body = 8.0 * np.clip(2.0 * time, 0.0, 1.0) * np.sin(2.0 * np.pi * 14.0 * time)
    sensor, model = Sensor(noise=NOISE), Model("hit", (*BASE.terms, term("asymmetric_friction")), {})
    simulator = Simulator(
        VALVE, Recorded(sample_rate=rate, samples=body), model=model,
        parameters=given, sample_rate=rate, block_size=200, seed=3, body_sensor=sensor, spool_sensor=sensor,
    )  # fmt: skip
    (found,) = records_from_blocks(simulator.records(seconds), "shaken")
    return found


@pytest.mark.parametrize("bias", [0.0, 0.3, 0.6, -0.6, 3.0])
@pytest.mark.parametrize(("forward", "backward"), [(0.5, 0.5), (0.6, 0.4), (0.3, 0.7)])
def test_a_bias_of_the_body_is_no_friction_that_differs_by_direction(
    bias: float, forward: float, backward: float
) -> None:
    """It is there from the start, and pushes no spool as the blows to one side above do."""
    of = shaken(forward_force=forward, backward_force=backward)
    of = replace(of, body=of.body + bias)
    mean = structure_of(BASE, VALVE, ["coulomb_friction"], (), {"coulomb_force": FORCE})
    fit = fit_structure(predictions(of), mean, steps=0)
    found = two_forces([readings_of(of)], VALVE, MOTIONS, fit)
    if forward == backward:
        assert found is None
    else:
        assert found is not None
        assert found.ratio == pytest.approx((forward - backward) / (forward + backward), abs=0.03)


@pytest.mark.slow
def test_all_of_the_friction_is_found_in_a_spool_that_sticks_between_blows() -> None:
    of = predictions(hit("coulomb_friction", coulomb_force=FORCE))
    names = ["coulomb_friction", "quadratic_damping", "presliding_friction"]
    search = Search(of, structure_of(BASE, VALVE), names)
    search.run()
    assert search.simplest.structure.effects == ("coulomb_friction",)
    assert search.simplest.structure.values["coulomb_force"] == pytest.approx(FORCE, rel=0.02)
