"""What the monitor says of sensors, converters and clocks that lie, and of a valve that it cannot judge."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class Record:
    """Blocks of 24 s, and the samples of their channels; none of them can be changed."""

    blocks: list[Block]
    body: Samples
    spool: Samples

    def having(self, channel: str, change: Callable[[Samples], Samples]) -> list[Block]:
        """Return the blocks with the samples of ``channel`` as ``change`` makes them."""
        row = change(getattr(self, channel))
        size = self.blocks[0].body.size
        return [
            replace(one, **{channel: row[number * size : (number + 1) * size]})
            for number, one in enumerate(self.blocks)
        ]


@pytest.fixture(scope="module", name="sound")
def _sound() -> Record:
    simulator = Simulator(
        VALVE, MACHINE, coulomb_force=0.1, sample_rate=1000.0, body_sensor=SENSOR, spool_sensor=SENSOR
    )
    blocks = list(simulator.records(24.0))
    rows = [np.concatenate([getattr(one, name) for one in blocks]) for name in ("body", "spool")]
    for row in (*rows, *(row for one in blocks for row in (one.body, one.spool))):
        row.flags.writeable = False
    return Record(blocks, *rows)


@pytest.fixture(scope="module", name="usual")
def _usual(sound: Record) -> Replay:
    """Return what the monitor makes of the sound record: to look at, not to go on with."""
    return replayed(sound.blocks)


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


#: What is like another one of them: a channel late and the other early, half as much and the other twice.
ALIKE = {
    ("three samples early", "body"), ("three samples early", "spool"), ("half", "body"), ("twice", "spool"),
    ("a tenth", "spool"), ("tenfold", "body"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("fault", "channel"),
    [
        pytest.param(fault, channel, marks=[pytest.mark.slow] * ((fault, channel) in ALIKE))
        for fault in FAULTS
        for channel in ("body", "spool")
    ],
)
def test_each_fault_of_a_channel_raises_its_own_cause_and_no_drift_or_other_sensor_fault(
    sound: Record, fault: str, channel: str
) -> None:
    change, cause = FAULTS[fault]
    found = replayed(sound.having(channel, change))
    events = [one for one in found.events if one.state is EventState.RAISED]
    # A spool that reads too much seems to resonate until both channels have been looked at, after 8 s.
    early = [one for one in events if one.stamp - sound.blocks[0].stamp < 8.5e9 and one.kind == "resonance"]
    assert cause[1] == "sensitivity" or not early
    # The machine shakes the valve at resonance, which no delay between both channels hides.
    seen = {("resonance", "")} if cause[1] == "clock_step" else set()
    assert raised(one for one in events if one not in early) == {cause, *seen}


def test_one_sensor_wired_twice_is_no_stuck_spool(sound: Record) -> None:
    twice = sound.having("spool", lambda _: sound.body)
    assert raised(replayed(twice).events) == {("sensor_fault", "same_channel")}


@pytest.mark.parametrize("channel", ["body", "spool"])
@pytest.mark.parametrize("value", [-9999.0, 400.0])
def test_impossible_samples_hide_no_resonance(
    sound: Record, usual: Replay, channel: str, value: float
) -> None:
    found = replayed(sound.having(channel, lambda row: every(row, value)))
    assert raised(usual.events) == {("resonance", "")}
    assert raised(found.events) == {("resonance", ""), ("data_fault", "outliers")}
    (event,) = [one for one in found.events if one.kind == "data_fault"]
    assert event.facts.subject == channel
    assert event.facts.evidence[0].value == value
    assert found.monitor.outliers.count == 8
    latest, other = found.estimator.latest, usual.estimator.latest
    assert latest is not None
    assert other is not None
    assert latest.natural_frequency.value == pytest.approx(other.natural_frequency.value, rel=2e-3)


def test_a_valve_that_nothing_can_judge_is_unknown_after_10_s_and_an_event_after_a_minute(
    sound: Record,
) -> None:
    monitor, events = Monitor(), []
    levels = {}
    begin, count = sound.blocks[0].stamp, len(sound.blocks)
    length = sound.blocks[-1].end - begin
    for number in range(4):  # four times 24 s, one behind the other
        for one in sound.blocks:
            later = replace(one, stamp=one.stamp + number * length, sequence=one.sequence + number * count)
            events += monitor.update(later)
            levels[round((later.end - begin) * 1e-9, 2)] = monitor.level
    assert {level for at, level in levels.items() if 12.0 < at < 60.0} == {HealthLevel.UNKNOWN}
    assert raised(events) == {("data_fault", "not_judged")}
    (event,) = events
    assert 60.0 <= (event.stamp - begin) * 1e-9 <= 63.0
    assert event.facts.note == "the valve's natural frequency is not known"
    assert monitor.health.summary == "Not judged"


def test_what_is_judged_is_never_called_blind(usual: Replay) -> None:
    assert usual.monitor.detection.blind == ""
    assert usual.monitor.level is not HealthLevel.UNKNOWN


def test_a_jump_of_a_channels_zero_is_no_step_of_a_clock() -> None:
    """For a moment a step of 0.7 s would account for it, which the next look does not confirm."""
    machine = from_mapping(
        {
            "kind": "machine_orders",
            "speed_profile": [[0.0, 1903.3]],
            "orders": [[1.0, 3.1], [2.0, 1.0]],
            "broadband_rms": 0.26,
            "broadband_low": 6.0,
            "broadband_high": 120.0,
        }
    )
    sensor = Sensor(noise=0.08)
    simulator = Simulator(
        VALVE, machine, coulomb_force=0.063, sample_rate=800.0, body_sensor=sensor, spool_sensor=sensor
    )
    blocks = list(simulator.records(40.0))
    later = blocks[0].stamp + 30_000_000_000
    jumped = (replace(one, spool=one.spool - np.float32(2.65 * (one.stamp >= later))) for one in blocks)
    assert ("data_fault", "clock_step") not in raised(replayed(jumped).events)
