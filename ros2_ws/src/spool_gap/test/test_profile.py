"""Profile likelihood: what a record determines, bounds on one side, or knows only with another number."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_estimator.identification.determination import RISE_95, verdict_of
from spool_estimator.identification.record import records_from_blocks
from spool_gap.evidence.analyse import analyse
from spool_gap.result import GapSettings
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve


@given(st.floats(-50.0, 50.0), st.floats(1e-3, 10.0))
def test_of_a_parabola_the_ends_are_those_of_the_normal_interval(best: float, deviation: float) -> None:
    steps = np.arange(-4.0, 4.5)
    values = tuple((best + steps * deviation).tolist())
    profile = verdict_of("drag", "N s/m", values, tuple((steps**2).tolist()), values[4])
    assert profile.verdict == "identifiable"
    assert profile.low == pytest.approx(best - 1.96 * deviation, abs=1e-3 * deviation)
    assert profile.high == pytest.approx(best + 1.96 * deviation, abs=1e-3 * deviation)


def test_a_side_that_stays_below_the_threshold_has_no_bound() -> None:
    flat = verdict_of("preload", "N", (1.0, 2.0, 3.0, 4.0), (9.0, 0.0, 0.5, 0.6), 2.0, "backlash")
    assert (flat.verdict, flat.high) == ("one-sided", None)
    assert flat.low == pytest.approx(2.0 - np.sqrt(RISE_95) / 3.0)
    assert "at least" in flat.sentence
    assert "backlash" in flat.sentence
    both = verdict_of("preload", "N", (1.0, 2.0, 3.0), (0.1, 0.0, 0.1), 2.0, "spring_stiffness")
    assert both.verdict == "only together"
    assert verdict_of("preload", "N", (1.0, 2.0, 3.0), (0.1, 0.0, 0.1), 2.0).verdict == "not identifiable"


@pytest.mark.slow
def test_the_friction_of_a_sweep_is_identifiable_and_its_interval_holds_the_truth() -> None:
    valve = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
    sweep = SweptSine(start_frequency=6.0, stop_frequency=45.0, duration=16.0, amplitude=8.0)
    sensor = Sensor(noise=0.03)
    simulator = Simulator(
        valve, sweep, model="coulomb", parameters={"coulomb_force": 0.4}, sample_rate=1000.0,
        block_size=500, body_sensor=sensor, spool_sensor=sensor, seed=4,
    )  # fmt: skip
    (record,) = records_from_blocks(simulator.records(16.0), "sweep")
    result = analyse([record], valve, MODELS["fluid"], settings=GapSettings(profiles=True))
    assert result.verdict == "coulomb_friction"
    (profile,) = result.profiles
    assert (profile.name, profile.verdict) == ("coulomb_force", "identifiable")
    assert profile.low is not None
    assert profile.high is not None
    assert profile.low < 0.4 < profile.high
    assert profile.high - profile.low < 0.02
