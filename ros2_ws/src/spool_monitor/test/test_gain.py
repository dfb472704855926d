"""The gain of the channels against its healthy value: an aged sensor is no spring, a loose one stays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from spool_core.block import Block
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.alarm import Operator
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.channels import GainChange, ValveResponse
from spool_monitor.detectors import MonitorSettings
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.replay import Replay
from spool_sim.excitation import MachineOrders
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
#: s before anything happens, and of a change that is slow.
BEFORE, SLOWLY = 30, 60


@cache
def blocks(seconds: int, softer: float = 0.0) -> tuple[Block, ...]:
    """Return blocks of a machine above resonance; the spring loses ``softer`` slowly."""
    shaking = MachineOrders(
        speed_profile=((0.0, 1440.0),), orders=((1.0, 5.0), (2.0, 1.75)), broadband_rms=1.0,
        broadband_low=6.0, broadband_high=120.0, broadband_lines=40, seed=3,
    )  # fmt: skip
    noisy = Sensor(noise=0.05)
    simulator = Simulator(
        VALVE, shaking, coulomb_force=0.1, seed=7, sample_rate=1000.0, block_size=50, body_sensor=noisy,
        spool_sensor=noisy,
    )  # fmt: skip
    made = list(simulator.records(float(BEFORE)))
    simulator.set_drift("spring_stiffness", (1.0 - softer) * VALVE.spring_stiffness, float(SLOWLY))
    return (*made, *simulator.records(float(seconds - BEFORE)))


def monitored(shown: list[Block]) -> Replay:
    monitor = Monitor(MonitorSettings(natural_frequency=VALVE.natural_frequency))
    one = Replay(Estimator(settings_for(VALVE)), monitor)
    one.run(shown)
    return one


def raised(events: list[Event]) -> set[tuple[str, str]]:
    return {(event.kind, event.cause) for event in events if event.state is EventState.RAISED}


def aged(channel: str, loss: float) -> list[Block]:
    """Return blocks whose ``channel`` loses a share of its sensitivity slowly."""
    shown = []
    for number, block in enumerate(blocks(140)):
        gain = np.float32(1.0 - loss * min(1.0, max(0.0, number / 20.0 - BEFORE) / SLOWLY))
        shown.append(replace(block, **{channel: getattr(block, channel) * gain}))
    return shown


@pytest.mark.parametrize(
    ("channel", "loss"), [("spool", 0.06), ("spool", 0.15), ("body", 0.06), ("body", 0.15)]
)
def test_a_slow_loss_of_sensitivity_is_the_sensors_and_no_spring(channel: str, loss: float) -> None:
    found = raised(monitored(aged(channel, loss)).events)
    assert ("sensor_fault", "scale") in found
    # Until the loss has lasted, an event may name both.
    assert found <= {
        ("sensor_fault", "scale"), ("spring_change", "sensor_or_spring"),
        ("friction_drift", "sensor_or_friction"),
    }  # fmt: skip


def test_a_spring_that_softens_slowly_changes_no_gain() -> None:
    assert raised(monitored(list(blocks(140, 0.1))).events) == {("spring_change", "softer")}


def test_a_loose_sensor_stays_loose_until_somebody_acknowledges() -> None:
    """Loose: peaks are pressed and rattle, for 20 s; then it is pushed tight again."""
    draw, shown = np.random.default_rng(2), []
    for number, block in enumerate(blocks(140)):
        body = np.asarray(block.body, dtype=np.float64)
        if 35 * 20 <= number < 55 * 20:
            limit = 1.2 * body.std()
            beyond = np.abs(body) > limit
            body = np.where(beyond, np.sign(body) * (limit + 0.3 * (np.abs(body) - limit)), body)
            body += beyond * draw.normal(0.0, 0.5 * limit, body.size)
        shown.append(replace(block, body=body.astype(np.float32)))
    one, store = monitored(shown[: 100 * 20]), AlarmStore()
    store.expect(one.monitor.conditions)
    assert raised(one.events) == {("sensor_fault", "scale")}
    assert one.monitor.detection.distrust
    for event in one.events:
        store.update(event)
    store.acknowledge("sensor_fault/sensor_scale", Operator("Eva", 1))
    one.run(shown[100 * 20 :])
    assert [event.state for event in one.events] == [EventState.RAISED, EventState.CLEARED]
    assert not one.monitor.detection.distrust


@pytest.mark.parametrize(
    ("change", "sensor"),
    [({}, True), ({"bend": 0.2}, False), ({"bend": 0.0}, False), ({"natural_frequency": 15.8}, False)],
)
def test_a_gain_that_changes_with_anything_else_is_no_sensors(change: dict[str, float], sensor: bool) -> None:
    """Dry friction bends the gain where it leaves more, or the machine shakes at another frequency."""
    response = ValveResponse(15.0, 30.0, 1.0, 0.02, 0.1, 0.1)
    made = GainChange()
    for second in range(1, 30):
        # A sensor that ages scales what the fit leaves as it does the gain.
        made.update(second * 10**9, replace(response, **{"gain": 0.9, "bend": 0.09} | change), 1.0, 0.1, 15.0)
    assert made.change == pytest.approx(-0.1)
    assert made.breaks is sensor
    assert not sensor or made.beyond == pytest.approx(0.1)
