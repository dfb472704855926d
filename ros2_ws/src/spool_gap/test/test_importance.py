"""An effect is named where it matters; a spool that is stuck, and oil that warms, are called that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spool_estimator.identification.record import Record, records_from_blocks
from spool_gap.evidence.analyse import analyse
from spool_gap.result import GapSettings
from spool_sim.excitation import SweptSine
from spool_sim.model import MODELS, Model
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
FLUID = MODELS["fluid"]
RATE = 1000.0


def recorded(effect: str, noise: float = 0.03, **values: float) -> Record:
    """Return 24 s of three sweeps of the fluid model with ``effect``."""
    model = Model("hidden", (*FLUID.terms, term(effect)), values) if effect else FLUID
    sweep = SweptSine(start_frequency=6.0, stop_frequency=45.0, duration=8.0, amplitude=8.0)
    sensor = Sensor(noise=noise)
    simulator = Simulator(
        VALVE, sweep, model=model, sample_rate=RATE, block_size=500, body_sensor=sensor, spool_sensor=sensor
    )
    (found,) = records_from_blocks(simulator.records(24.0), "sweeps")
    return found


@pytest.mark.slow
def test_an_effect_that_hardly_changes_the_acceleration_is_told_and_not_named() -> None:
    record = recorded("cubic_stiffness", 0.005, cubic_coefficient=2e6)
    named = analyse([record], VALVE, FLUID, settings=GapSettings(least_share=0.0))
    assert named.verdict == "cubic_stiffness"
    found = analyse([record], VALVE, FLUID, settings=GapSettings(least_share=0.2))
    assert found.verdict == "none"
    assert not found.effects
    (small,) = found.small_effects
    assert small.id == "cubic_stiffness"
    assert 0.0 < small.share < 0.2
    (size,) = small.parameters
    assert size.value == pytest.approx(2e6, abs=4.0 * size.standard_deviation, rel=0.02)


@pytest.mark.slow
def test_oil_that_warms_is_damping_that_drifts_on_an_exponential_course() -> None:
    record = recorded("damping_drift", damping_drift_rate=-0.08, damping_drift_time=6.0)
    found = analyse([record], VALVE, FLUID)
    assert found.verdict == "damping_drift"
    numbers = {q.name: q for q in found.effects[0].parameters}
    for name, truth in (("damping_drift_rate", -0.08), ("damping_drift_time", 6.0)):
        assert numbers[name].value == pytest.approx(truth, abs=4.0 * numbers[name].standard_deviation)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_locked_spool_is_stuck_and_has_no_friction_law(noise: float) -> None:
    record = recorded("")
    read = record.body + noise * np.random.default_rng(1).standard_normal(record.body.size)
    found = analyse([replace(record, spool=read)], VALVE, FLUID)
    assert found.verdict == "unexplained"
    assert not found.effects
    assert found.sentence.startswith("The spool is stuck")


def clipped_in_both(share: float) -> Record:
    record = recorded("")
    rail = float(np.quantile(np.abs([record.body, record.spool]), 1.0 - share))
    return replace(record, body=np.clip(record.body, -rail, rail), spool=np.clip(record.spool, -rail, rail))


def test_a_record_that_is_clipped_throughout_is_saturation_with_what_to_do() -> None:
    found = analyse([clipped_in_both(0.25)], VALVE, FLUID)
    assert found.verdict == "sensor_saturation"
    clipped = [entry for entry in found.nuisances if entry.id == "clipping"]
    assert {entry.channel for entry in clipped} == {"body", "spool"}
    assert all("measuring range" in entry.check for entry in clipped)


@pytest.mark.slow
def test_both_channels_clipped_is_saturation_and_no_mechanics() -> None:
    found = analyse([clipped_in_both(0.1)], VALVE, FLUID)
    assert found.verdict == "sensor_saturation"
    assert {entry.channel for entry in found.nuisances if entry.id == "clipping"} >= {"spool"}


@pytest.mark.slow
def test_a_search_out_of_time_states_that_thorough_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spool_gap.evidence.analyse.ALLOWED", 0.0)
    record = recorded("cubic_stiffness", cubic_coefficient=5e7)
    hurried = analyse([record], VALVE, FLUID)
    assert any("stopped early" in line and "--thorough" in line for line in hurried.warnings)
    thorough = analyse([record], VALVE, FLUID, settings=GapSettings(thorough=True))
    assert thorough.verdict == "cubic_stiffness"
    assert not any("stopped early" in line for line in thorough.warnings)
