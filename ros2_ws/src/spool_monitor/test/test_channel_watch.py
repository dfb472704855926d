"""What the monitor says of sensors, converters and clocks that lie, and of a valve that it cannot judge."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from spool_core.block import Block, Samples
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import HealthLevel, Monitor
from spool_monitor.replay import Replay
from spool_sim.excitation import from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
#: A machine at 18 Hz that slows down to the valve's 15 Hz from 15 to 18 s.
MACHINE = from_mapping(
    {
        "kind": "machine_orders",
        "speed_profile": [[0.0, 1080.0], [15.0, 1080.0], [18.0, 900.0], [24.0, 900.0]],
        "orders": [[1.0, 8.0], [2.0, 2.0]],
        "broadband_rms": 1.5,
    }
)
SENSOR = Sensor(noise=0.03)
SOUND = list(
    Simulator(
        VALVE, MACHINE, coulomb_force=0.1, sample_rate=1000.0, body_sensor=SENSOR, spool_sensor=SENSOR
    ).records(24.0)
)
BODY, SPOOL = (np.concatenate([getattr(one, name) for one in SOUND]) for name in ("body", "spool"))


def blocks(body: Samples, spool: Samples) -> list[Block]:
    """Return the blocks of a source with these samples."""
    size = SOUND[0].body.size
    return [
        replace(one, body=body[first : first + size], spool=spool[first : first + size])
        for one, first in zip(SOUND, range(0, body.size, size), strict=True)
    ]


def replayed(stream: Iterable[Block]) -> Replay:
    monitor = Monitor()
    monitor.set_natural_frequency(VALVE.natural_frequency)
    one = Replay(Estimator(settings_for(VALVE)), monitor)
    one.run(stream)
    return one


def raised(events: Iterable[Event]) -> set[tuple[str, str]]:
    return {(one.kind, one.cause) for one in events if one.state is EventState.RAISED}


def shifted(row: Samples, by: int) -> Samples:
    return np.concatenate([row[:10_000], np.roll(row, by)[10_000:]])


def in_16_bits(row: Samples) -> Samples:
    count = float(np.abs(row).max()) / 2.2 / 32768
    whole = (np.round(row / count).astype(np.int64) + 32768) % 65536 - 32768
    return (whole * count).astype(np.float32)


def every(row: Samples, value: float) -> Samples:
    spoiled = row.copy()
    spoiled[4000::2500] = value
    return spoiled


#: What the samples suffer, and the event that says so.
FAULTS: dict[str, tuple[Callable[[Samples], Samples], tuple[str, str]]] = {
    "read twice": (lambda row: np.repeat(row[::2], 2), ("data_fault", "repeats")),
    "wraps": (in_16_bits, ("sensor_fault", "wrap_around")),
    "three samples late": (lambda row: shifted(row, 3), ("data_fault", "clock_step")),
    "three samples early": (lambda row: shifted(row, -3), ("data_fault", "clock_step")),
    "a tenth": (lambda row: np.float32(0.1) * row, ("sensor_fault", "sensitivity")),
    "half": (lambda row: np.float32(0.5) * row, ("sensor_fault", "sensitivity")),
    "twice": (lambda row: np.float32(2.0) * row, ("sensor_fault", "sensitivity")),
    "tenfold": (lambda row: np.float32(10.0) * row, ("sensor_fault", "sensitivity")),
}


@pytest.mark.parametrize("channel", ["body", "spool"])
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_channel_raises_its_own_cause_and_no_drift_or_other_sensor_fault(
    fault: str, channel: str
) -> None:
    change, cause = FAULTS[fault]
    rows = (change(BODY), SPOOL) if channel == "body" else (BODY, change(SPOOL))
    events = [one for one in replayed(blocks(*rows)).events if one.state is EventState.RAISED]
    # A spool that reads too much seems to resonate until both channels have been looked at, after 8 s.
    early = [one for one in events if one.stamp - SOUND[0].stamp < 8.5e9 and one.kind == "resonance"]
    assert cause[1] == "sensitivity" or not early
    assert raised(one for one in events if one not in early) == {cause}


def test_one_sensor_wired_twice_is_no_stuck_spool() -> None:
    assert raised(replayed(blocks(BODY, BODY)).events) == {("sensor_fault", "same_channel")}


@pytest.mark.parametrize("channel", ["body", "spool"])
@pytest.mark.parametrize("value", [-9999.0, 400.0])
def test_impossible_samples_hide_no_resonance(channel: str, value: float) -> None:
    rows = (every(BODY, value), SPOOL) if channel == "body" else (BODY, every(SPOOL, value))
    found = replayed(blocks(*rows))
    sound = replayed(SOUND)
    assert raised(sound.events) == {("resonance", "")}
    assert raised(found.events) == {("resonance", ""), ("data_fault", "outliers")}
    (event,) = [one for one in found.events if one.kind == "data_fault"]
    assert event.facts.subject == channel
    assert event.facts.evidence[0].value == value
    assert found.monitor.outliers.count == 8
    latest, usual = found.estimator.latest, sound.estimator.latest
    assert latest is not None
    assert usual is not None
    assert latest.natural_frequency.value == pytest.approx(usual.natural_frequency.value, rel=2e-3)


def test_a_valve_that_nothing_can_judge_is_unknown_after_10_s_and_an_event_after_a_minute() -> None:
    monitor, events = Monitor(), []
    levels = {}
    for number in range(4):  # four times 24 s, one behind the other
        for one in SOUND:
            last = SOUND[-1].end - SOUND[0].stamp
            later = replace(one, stamp=one.stamp + number * last, sequence=one.sequence + number * len(SOUND))
            events += monitor.update(later)
            levels[round((later.end - SOUND[0].stamp) * 1e-9, 2)] = monitor.level
    assert {level for at, level in levels.items() if 12.0 < at < 60.0} == {HealthLevel.UNKNOWN}
    assert raised(events) == {("data_fault", "not_judged")}
    (event,) = events
    assert 60.0 <= (event.stamp - SOUND[0].stamp) * 1e-9 <= 63.0
    assert event.facts.note == "the valve's natural frequency is not known"
    assert monitor.health.summary == "Not judged"


def test_what_is_judged_is_never_called_blind() -> None:
    found = replayed(SOUND)
    assert found.monitor.detection.blind == ""
    assert found.monitor.level is not HealthLevel.UNKNOWN
