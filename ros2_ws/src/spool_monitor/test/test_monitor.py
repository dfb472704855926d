"""The monitor over simulated valves whose truth is known."""

from __future__ import annotations

import math
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from spool_core.block import Block, BlockRun, joined
from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import headline
from spool_core.uncertainty import Validity
from spool_estimator.estimate import State
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import Judgement, MonitorSettings
from spool_monitor.detectors.stale import STALE_AFTER
from spool_monitor.event import Event, EventState, Severity
from spool_monitor.monitor import (
    FIRST_BLOCK,
    FIRST_ESTIMATE,
    MOST_TOGETHER,
    BaselineState,
    HealthLevel,
    Monitor,
)
from spool_monitor.replay import Replay
from spool_sim.excitation import PRESETS, Excitation, from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

NOISY = Sensor(noise=0.05)
START = 1_700_000_000_000_000_000
#: From block to block, s.
PERIOD = 0.02


def machine(*speeds: tuple[float, float]) -> Excitation:
    """Return a shaft's vibration whose speed runs through (s, rpm)."""
    return from_mapping(
        {
            "kind": "machine_orders",
            "speed_profile": [list(speed) for speed in speeds],
            "orders": [[1.0, 8.0], [2.0, 2.0]],
            "broadband_rms": 1.5,
            "broadband_lines": 30,
        }
    )


STEADY = machine((0.0, 1500.0), (1000.0, 1500.0))
RESONANT = machine((0.0, 920.0), (1000.0, 920.0))
#: From 25 Hz to 10 Hz, at 1.5 Hz/s through the soft valve's 15.15 Hz.
PASSAGE = machine((0.0, 1500.0), (8.0, 1500.0), (18.0, 600.0), (1000.0, 600.0))


@dataclass
class Stream:
    """A simulated valve and the blocks that it has sent: simulated once for all tests that look at them."""

    simulator: Simulator
    sent: list[Block]

    def part(self, first: int, count: int) -> list[Block]:
        """Return ``count`` blocks from number ``first`` on; their samples cannot be changed."""
        missing = first + count - len(self.sent)
        if missing > 0:
            for block in self.simulator.records(missing * PERIOD):
                block.body.flags.writeable = block.spool.flags.writeable = False
                self.sent.append(block)
        return self.sent[first : first + count]


@lru_cache
def shared_stream(excitation: Excitation, valve: str, seed: int, sensor: Sensor) -> Stream:
    simulator = Simulator(
        find_valve(valve),
        excitation,
        coulomb_force=0.1,
        seed=seed,
        body_sensor=sensor,
        spool_sensor=sensor,
        start_stamp=START,
    )
    return Stream(simulator, [])


@dataclass
class Run:
    """A simulated valve with its estimator and monitor."""

    stream: Stream
    replay: Replay
    taken: int = 0

    def records(self, seconds: float) -> list[Block]:
        """Return the blocks of the next ``seconds``."""
        first, count = self.taken, round(seconds / PERIOD)
        self.taken += count
        return self.stream.part(first, count)

    def go(self, seconds: float) -> list[Event]:
        """Run on; return what happened meanwhile."""
        before = len(self.replay.events)
        self.replay.run(self.records(seconds))
        return self.replay.events[before:]

    @property
    def simulator(self) -> Simulator:
        return self.stream.simulator

    @property
    def monitor(self) -> Monitor:
        return self.replay.monitor

    def at(self, event: Event) -> float:
        assert self.replay.first_stamp is not None
        return (event.stamp - self.replay.first_stamp) * 1e-9


def run(excitation: Excitation, valve: str = "4weh10_soft", *, seed: int = 1, sensor: Sensor = NOISY) -> Run:
    """Return a new estimator and monitor of a valve that other tests look at as well."""
    found = find_valve(valve)
    source = shared_stream(excitation, valve, seed, sensor)
    monitor = Monitor(MonitorSettings(natural_frequency=found.natural_frequency))
    return Run(source, Replay(Estimator(settings_for(found)), monitor))


def kinds(events: list[Event]) -> list[tuple[str, str, EventState]]:
    return [(event.kind, event.cause, event.state) for event in events]


def blocks(seconds: float, excitation: Excitation = STEADY) -> list[Block]:
    return run(excitation).records(seconds)


# What the machine does.


def test_a_resonance_passage_is_raised_in_time_and_cleared_after() -> None:
    one = run(PASSAGE)
    natural = one.simulator.truth.natural_frequency
    passing = 8.0 + 10.0 * (25.0 - natural) / 15.0
    events = one.go(24.0)
    assert [(event.kind, event.state) for event in events] == [
        ("resonance", EventState.RAISED),
        ("resonance", EventState.CLEARED),
    ]
    raised, cleared = events
    assert passing - 2.0 < one.at(raised) < passing + 3.0
    assert one.at(cleared) < 18.0 + 3.0
    assert raised.quantity.name == "amplification"
    assert raised.quantity.value >= 1.8


def test_a_machine_that_stays_in_resonance_stays_raised_until_it_stands_still() -> None:
    one = run(RESONANT)
    assert [(event.kind, event.state) for event in one.go(20.0)] == [("resonance", EventState.RAISED)]
    assert one.monitor.health.level >= HealthLevel.WARNING
    assert "resonance" in one.monitor.health.active
    (last,) = one.records(PERIOD)
    random = np.random.default_rng(1)
    events: list[Event] = []
    for number in range(150):  # 3 s of noise alone
        stamp = last.stamp + number * 20_000_000
        noise = random.normal(0.0, 0.05, (2, last.body.size)).astype(np.float32)
        events += one.monitor.update(Block(stamp, last.sequence + number, last.sample_period, *noise))
    assert [(event.kind, event.state) for event in events] == [("resonance", EventState.CLEARED)]
    assert dict(one.monitor.health.judgements)["resonance"] is Judgement.NOT_EXCITED


def test_a_healthy_machine_raises_nothing() -> None:
    one = run(STEADY)
    assert one.go(60.0) == []
    health = one.monitor.health
    assert (health.level, health.baseline, health.active) == (HealthLevel.OK, BaselineState.FROZEN, ())
    assert health.dominant_frequency.value == pytest.approx(25.0, abs=0.2)
    assert health.natural_frequency.value == pytest.approx(one.simulator.truth.natural_frequency, rel=0.01)
    assert health.stamp == START + 60_000_000_000


#: A converter of 12 bit over 16 g behind the noise of an accelerometer that is below half its step.
COARSE = Sensor(noise=0.01, resolution=0.08)


def test_a_standstill_raises_nothing() -> None:
    one = run(PRESETS["standstill"])
    assert one.go(60.0) == []
    assert one.monitor.health.level in (HealthLevel.OK, HealthLevel.UNKNOWN)
    assert one.monitor.health.baseline is not BaselineState.FROZEN


def test_how_the_stream_is_split_changes_no_event_and_no_health() -> None:
    whole = joined(blocks(24.0, PASSAGE))
    fine, coarse = run(PASSAGE), run(PASSAGE)
    for one, size in ((fine, 20), (coarse, 200)):
        one.replay.run(replace(BlockRun.of(whole), size=size, sequence=0).blocks())
    assert fine.replay.events
    for first, second in zip(fine.replay.events, coarse.replay.events, strict=True):
        assert (first.kind, first.state, first.severity) == (second.kind, second.state, second.severity)
        assert abs(first.stamp - second.stamp) <= 2
    assert fine.monitor.health == coarse.monitor.health


# Faults of the data.


def test_lost_blocks_are_a_data_fault_that_clears() -> None:
    monitor = Monitor()
    events: list[Event] = []
    for block in blocks(70.0):
        if block.sequence not in (200, 201, 202):
            events += monitor.update(block)
    events = [one for one in events if one.cause == "lost"]
    assert [one.state for one in events] == [EventState.RAISED, EventState.CLEARED]
    assert events[0].stamp == START + 203 * 20_000_000
    assert events[1].stamp - events[0].stamp == pytest.approx(60e9, abs=3e7)
    assert events[0].quantity.value == 3.0
    facts = events[0].facts
    assert (facts.parameter, facts.value, facts.limit) == ("faulty_blocks", 3.0, 0.0)
    assert {one.name: one.value for one in facts.evidence} == {"lost_blocks": 3.0, "refused_blocks": 0.0}


def test_blocks_that_a_busy_controller_dropped_blame_neither_network_nor_source() -> None:
    """Each drop is longer than the silence that is reported of a source, and no estimate comes of one."""
    monitor, events = Monitor(), list[Event]()
    for block in blocks(20.0):
        place = block.sequence % 200
        if place >= 100:
            continue
        events += monitor.update(replace(block, dropped=100 if block.sequence and place == 0 else 0))
        events += monitor.idle(0.0, block.sequence * PERIOD)
    found = [one for one in events if one.kind == "data_fault"]
    assert [(one.cause, one.state, one.severity) for one in found] == [
        ("overload", EventState.RAISED, Severity.WARNING)
    ]
    assert headline(found[0]) == "Controller too busy: 101 of 201 blocks judged"
    assert headline(found[0], LANGUAGES["de"]) == "Rechner überlastet: 101 von 201 Blöcken beurteilt"
    assert not [one for one in events if one.kind == "stale"]
    assert monitor.gate.lost == 400


def test_refused_blocks_are_a_data_fault_and_nothing_is_computed_from_them() -> None:
    hurt, whole = Monitor(), Monitor()
    events: list[Event] = []
    for block in blocks(4.0):
        whole.update(block)
        if block.sequence == 60:
            broken = replace(block, body=np.full_like(block.body, np.nan))
            events += hurt.update(broken)
            events += hurt.update(replace(block, spool=block.spool[:-1]))
            events += hurt.update(replace(block, stamp=0))
        events += hurt.update(block)
    assert [one.source for one in events] == [f"malformed/{one}" for one in ("samples", "lengths", "no_time")]
    assert {one.severity for one in events} == {Severity.WARNING}
    assert events[0].stamp == START + 60 * 20_000_000
    assert hurt.gate.refused == 3
    assert hurt.line == whole.line
    assert hurt.health.level is HealthLevel.WARNING
    assert hurt.room(PERIOD / 40) == pytest.approx(57.2 * 40 / PERIOD, abs=40)
    assert whole.room(PERIOD / 40) == MOST_TOGETHER


def test_a_block_lost_now_and_then_is_one_event_with_its_first_time() -> None:
    """A minute without a loss ends it."""
    monitor, events, samples = Monitor(), list[Event](), np.zeros(10, dtype=np.float32)
    for number in range(3000):
        if number % 300 != 150 or number > 2000:
            stamp = START + number * 100_000_000
            events += monitor.update(Block(stamp, number, 0.01, samples, samples))
    lost = [one for one in events if one.cause == "lost"]
    assert [one.state for one in lost] == [EventState.RAISED, EventState.CLEARED]
    assert [(one.stamp - START) * 1e-9 for one in lost] == pytest.approx([15.1, 195.1 + 60.0], abs=0.11)
    assert lost[1].facts.began == lost[0].stamp


def test_a_fault_before_any_data_is_reported_without_harm() -> None:
    monitor = Monitor()
    (first,) = blocks(PERIOD)
    (event,) = monitor.update(replace(first, sample_period=math.nan))
    assert (event.kind, event.cause) == ("data_fault", "malformed")
    (silence,) = monitor.idle(60.0, 60.0, now=START)
    assert (silence.kind, silence.cause) == ("stale", "acceleration")
    assert (silence.facts.value, silence.facts.limit) == (60.0, monitor.settings[STALE_AFTER] + FIRST_BLOCK)
    assert kinds(monitor.update(first)) == [("stale", "acceleration", EventState.CLEARED)]
    assert monitor.health.stamp == first.end


def altered(blocks_: Iterable[Block], first: float, **rows: float | None) -> Iterator[Block]:
    """Return blocks whose channels stand from ``first`` s on: at a value, or (None) at their last sample."""
    last: dict[str, np.float32] = {}
    for block in blocks_:
        if block.stamp - START >= round(first * 1e9):
            full = {
                name: np.full_like(block.body, last.get(name, 0.0) if value is None else value)
                for name, value in rows.items()
            }
            yield replace(block, **full)
        else:
            last = {"body": block.body[-1], "spool": block.spool[-1]}
            yield block


@pytest.mark.parametrize(
    ("value", "first"), [(None, 0.0), (None, 7.34), (0.0, 7.34), (9.81, 0.0), (1e-40, 7.34)]
)
def test_an_acquisition_that_stands_still_is_a_dead_sensor_within_2_s(
    value: float | None, first: float
) -> None:
    before = run(STEADY)
    before.go(first)
    kept = pickle.dumps(before.replay)
    for names in (("body", "spool"), ("body",), ("spool",)):
        one = replace(before, replay=pickle.loads(kept))
        ahead = before.stream.part(before.taken - 1, 1) if before.taken else []
        rest = altered(ahead + one.records(4.0), first, **dict.fromkeys(names, value))
        one.replay.run(list(rest)[len(ahead) :])
        assert [event.facts.subject for event in one.replay.events] == list(names)
        for event in one.replay.events:
            assert (event.kind, event.cause, event.severity) == ("sensor_fault", "dead", Severity.ALARM)
            assert first < one.at(event) <= first + 2.0
            unchanged = {one.name: one.value for one in event.facts.evidence}["unchanged_time"]
            assert 0.25 <= unchanged <= 2.0


def test_without_a_valves_description_an_acquisition_that_stands_still_is_found_as_well() -> None:
    monitor = Monitor()
    events = [e for block in altered(blocks(8.0), 5.0, body=None, spool=None) for e in monitor.update(block)]
    assert kinds(events) == [("sensor_fault", "dead", EventState.RAISED)] * 2


def test_an_acquisition_that_goes_on_clears_its_fault_though_the_machine_rests() -> None:
    monitor = Monitor()
    events: list[Event] = []
    for block in blocks(20.0, PRESETS["standstill"]):
        late = block.stamp - START >= 5_000_000_000
        zeros = np.zeros_like(block.body)
        events += monitor.update(block if late else replace(block, body=zeros, spool=zeros))
    assert [event.state for event in events] == [EventState.RAISED] * 2 + [EventState.CLEARED] * 2
    assert (events[-1].stamp - START) * 1e-9 < 5.0 + 6.0


def test_a_machine_that_comes_to_rest_behind_a_coarse_converter_raises_nothing() -> None:
    """The machine's vibration dies away within a second, then no code changes for half a minute."""
    one = run(STEADY)
    events: list[Event] = []
    last = np.ones(1, np.float32)
    for block in one.records(40.0):
        time = 1e-9 * (block.stamp - START) + block.sample_period * np.arange(block.body.size)
        fading = np.exp(-np.maximum(0.0, time - 10.0) / 0.2)
        body, spool = (
            (np.rint(fading * row / 0.08) * 0.08).astype(np.float32) for row in (block.body, block.spool)
        )
        events += one.monitor.update(replace(block, body=body, spool=spool))
        last = np.abs(np.concatenate((body, spool)))
    assert last.max() == 0.0
    assert events == []


def test_an_acquisition_with_a_coarse_converter_that_stops_in_a_motion_is_found() -> None:
    one = run(STEADY, sensor=COARSE)
    one.replay.run(altered(one.records(10.0), 7.0, body=None, spool=None))
    assert kinds(one.replay.events) == [("sensor_fault", "dead", EventState.RAISED)] * 2
    assert one.at(one.replay.events[-1]) <= 9.0


@pytest.mark.parametrize("off", [-0.9, -0.3, -0.1, -0.005, 0.005, 0.9])
def test_a_wrong_sample_period_is_a_rate_fault_within_3_s_and_nothing_else(off: float) -> None:
    """At 15.15 Hz / 0.9 and 0.7 the shaft would pass for one in resonance, at the wrong rate."""
    one = run(RESONANT)
    wrong = [replace(block, sample_period=block.sample_period * (1.0 + off)) for block in one.records(8.0)]
    one.replay.run(wrong)
    (event,) = one.replay.events
    assert (event.kind, event.cause, event.source) == ("data_fault", "rate", "rate")
    assert event.severity is Severity.ALARM
    assert one.at(event) <= 3.0
    assert one.monitor.health.level is HealthLevel.ALARM
    latest = one.replay.estimator.latest
    assert latest is None or not any(quantity.known for quantity in latest.parameters)


@pytest.mark.parametrize(("size", "foreign"), [(1, True), (40, False)], ids=["another id", "the same id"])
def test_a_second_source_is_a_fault_and_no_alarm_of_the_valve(size: int, foreign: bool) -> None:
    """``size``: blocks that come in a row from each, in an order that changes at random."""
    one, other = run(STEADY), run(STEADY, "4weh10_stiff", seed=2)
    ours = [replace(block, source="valve_1") for block in one.records(30.0)]
    name = "valve_2" if foreign else "valve_1"
    theirs = [
        replace(block, source=name, sequence=block.sequence + 7_000, stamp=block.stamp + 3_000_000)
        for block in other.records(30.0)
    ]
    random = np.random.default_rng(3)
    both = ours[:1000]
    for first in range(1000, 1500, size):
        pair = [ours[first : first + size], theirs[first : first + size]]
        if size == 1 and random.random() < 0.5:
            pair.reverse()
        both += [block for part in pair for block in part]
    one.replay.run(both)
    assert {(event.kind, event.cause) for event in one.replay.events} <= {
        ("data_fault", "source"),
        ("data_fault", "malformed"),
    }
    (fault,) = [event for event in one.replay.events if event.cause == "source"]
    assert one.at(fault) < 21.0
    if foreign:
        assert fault.facts.subject == "valve_2"
    alone = run(STEADY)
    alone.replay.run(ours)
    assert one.replay.estimator.latest is not None
    assert alone.replay.estimator.latest is not None
    assert one.replay.estimator.latest.parameters == alone.replay.estimator.latest.parameters


@pytest.mark.parametrize("hours", [-1, 1])
def test_a_clock_that_is_set_by_an_hour_raises_no_silence_and_makes_no_time_negative(hours: int) -> None:
    one = run(STEADY)
    step = hours * 3_600_000_000_000
    one.replay.run(
        replace(block, stamp=block.stamp + (step if block.sequence >= 500 else 0))
        for block in one.records(20.0)
    )
    assert {event.kind for event in one.replay.events} == {"data_fault"}
    assert [(event.source, event.state) for event in one.replay.events] == [
        ("malformed/time", EventState.RAISED)
    ]
    assert one.replay.first_stamp is not None
    assert one.replay.last_stamp is not None
    assert one.replay.last_stamp > one.replay.first_stamp
    assert one.monitor.health.summary == "Malformed blocks"


# A valve that is not described.


@pytest.mark.parametrize("speed", [920.0, 1740.0])
def test_without_a_description_no_sensor_of_a_stiff_valve_is_accused(speed: float) -> None:
    monitor = Monitor()
    stiff = run(machine((0.0, speed), (99.0, speed)), "4weh10_stiff")
    assert [event for block in stiff.records(30.0) for event in monitor.update(block)] == []
    health = monitor.health
    assert health.natural_frequency.validity is Validity.UNKNOWN
    waiting = {name for name, judgement in health.judgements if judgement is Judgement.NOT_JUDGED}
    assert waiting == {"resonance", "sensor_dead", "sensor_scale", "sensor_swapped", "stuck_spool"}


def test_an_estimate_stands_in_for_a_missing_description() -> None:
    one = run(machine((0.0, 920.0), (99.0, 920.0)), "4weh10_stiff")
    replay = Replay(one.replay.estimator, Monitor())
    replay.run(one.records(20.0))
    assert replay.events == []
    judgements = dict(replay.monitor.health.judgements)
    assert {judgements[name] for name in ("resonance", "sensor_dead", "stuck_spool")} == {Judgement.JUDGED}


# Silence.


def test_a_valve_that_never_sent_is_stale_after_the_time_to_start() -> None:
    monitor = Monitor()
    patience = monitor.settings[STALE_AFTER] + FIRST_BLOCK
    assert monitor.idle(patience, patience, now=START) == []
    health = monitor.health
    assert (health.level, health.baseline) == (HealthLevel.UNKNOWN, BaselineState.UNKNOWN)
    assert health.summary == "waiting for data"
    (event,) = monitor.idle(patience + 0.1, patience + 0.1, now=START)
    assert (event.kind, event.cause, event.source) == ("stale", "never_seen", "acceleration")
    assert (event.severity, event.stamp) == (Severity.ALARM, START)
    assert event.code == event.facts.advice == 803
    assert monitor.idle(1e6, 1e6, now=START) == []
    health = monitor.health
    assert (health.level, health.active) == (HealthLevel.STALE, ("stale",))
    assert health.summary == "acceleration never seen: check the topic name"
    (cleared,) = monitor.update(blocks(PERIOD)[0])
    assert (cleared.kind, cleared.state) == ("stale", EventState.CLEARED)
    assert health.dominant_frequency.validity is Validity.UNKNOWN
    assert math.isnan(health.viscous_drift.value)


def test_a_source_that_nobody_has_started_yet_is_no_alarm_and_no_healthy_valve() -> None:
    monitor = Monitor()
    assert monitor.idle(0.0, 1e6, now=START, nobody="/valve_1/acceleration") == []
    health = monitor.health
    assert (health.level, health.namur.name) == (HealthLevel.UNKNOWN, "UNKNOWN")
    assert (
        health.summary
        == "nobody publishes on /valve_1/acceleration: start the source or check its topic name"
    )
    assert monitor.idle(1.0, 1e6, now=START) == []
    assert monitor.health.summary == "waiting for data"


def test_idle_raises_silence_of_the_accelerometers_once_and_data_clear_it() -> None:
    one = run(STEADY)
    one.go(5.0)
    monitor = one.monitor
    assert monitor.idle(1.4, 1.9) == []
    (event,) = monitor.idle(1.6, 2.1)
    assert (event.kind, event.cause, event.severity) == ("stale", "acceleration", Severity.ALARM)
    assert event.stamp == START + 6_600_000_000
    assert monitor.idle(9.0, 9.5) == []
    health = monitor.health
    assert (health.level, health.active, health.summary) == (HealthLevel.STALE, ("stale",), "no acceleration")
    assert health.dominant_frequency.validity is Validity.UNKNOWN
    events = one.go(1.0)
    assert kinds(events[:1]) == [("stale", "acceleration", EventState.CLEARED)]
    assert monitor.health.level is HealthLevel.OK


def test_idle_raises_silence_of_the_estimator_only_where_data_go_on() -> None:
    one = run(STEADY)
    one.go(5.0)
    monitor = one.monitor
    for block in one.records(1.4):
        assert monitor.update(block) == []
    # Late blocks, a pause or a process that was held up: time went by, but the estimator had no data.
    assert monitor.idle(0.02, 60.0) == []
    for block in one.records(0.2):
        assert monitor.update(block) == []
    assert monitor.idle(0.02, 1.5) == []
    (event,) = monitor.idle(0.02, 1.6)
    assert (event.kind, event.cause) == ("stale", "estimate")
    assert monitor.health.summary == "no estimate"
    latest = one.replay.estimator.latest
    assert latest is not None
    later = replace(latest, stamp=latest.stamp + 1_000_000_000, samples=latest.samples + 1)
    (cleared,) = monitor.update_estimate(later)
    assert (cleared.cause, cleared.state) == ("estimate", EventState.CLEARED)


def test_the_first_estimate_may_take_longer() -> None:
    monitor = Monitor()
    patience = monitor.settings[STALE_AFTER] + FIRST_ESTIMATE
    for block in blocks(patience + 0.5):
        monitor.update(block)
    assert monitor.idle(0.0, patience) == []
    (event,) = monitor.idle(0.0, patience + 0.1)
    assert (event.kind, event.cause) == ("stale", "estimate")


def test_a_monitor_that_was_paused_missed_nothing_and_goes_on() -> None:
    one = run(STEADY)
    one.go(5.0)
    one.records(20.0)  # while it was inactive
    one.monitor.gate.resume()
    events = [event for block in one.records(5.0) for event in one.monitor.update(block)]
    gate = one.monitor.gate
    assert kinds(events) == []
    assert (gate.lost, gate.refused, gate.confirmed) == (0, 0, True)
    assert one.monitor.health.dominant_frequency.known


def test_a_gap_in_the_stamps_says_when_silence_was_due_and_when_it_ended() -> None:
    monitor = Monitor()
    all_blocks = blocks(10.0)
    events = [event for block in all_blocks[:200] + all_blocks[400:] for event in monitor.update(block)]
    stale = [event for event in events if event.kind == "stale"]
    assert [(event.state, (event.stamp - START) * 1e-9) for event in stale] == [
        (EventState.RAISED, pytest.approx(4.0 + 1.5)),
        (EventState.CLEARED, pytest.approx(8.0)),
    ]
    assert stale[0].quantity.value == pytest.approx(4.0)


def test_a_gap_shorter_than_that_is_no_silence() -> None:
    monitor = Monitor()
    all_blocks = blocks(6.0)
    events = [event for block in all_blocks[:100] + all_blocks[170:] for event in monitor.update(block)]
    assert {event.kind for event in events} == {"data_fault"}


def test_a_record_played_again_is_watched_as_before() -> None:
    """The stamps go back by 24 s: neither lines nor events hang on the old time."""
    monitor = Monitor(MonitorSettings(natural_frequency=15.15))
    rounds = [[e for block in blocks(24.0, PASSAGE) for e in monitor.update(block)] for _ in range(2)]
    resonances = [[(e.stamp, e.state) for e in events if e.kind == "resonance"] for events in rounds]
    assert [state for _, state in resonances[0]] == [EventState.RAISED, EventState.CLEARED]
    assert [state for _, state in resonances[1]] == [EventState.RAISED, EventState.CLEARED]
    # The gate believes a clock set back at the second block: looks come a block of 20 ms later.
    for (first, _), (again, _) in zip(*resonances, strict=True):
        assert abs(again - first) <= 20_000_000


def test_a_held_estimate_alone_makes_a_valve_stale() -> None:
    one = run(STEADY)
    one.go(5.0)
    held = one.replay.estimator.stale()
    assert held is not None
    assert held.state is State.STALE
    late = Monitor()
    late.update_estimate(held)
    assert late.health.level is HealthLevel.STALE


# Settings, copies, memory.


def test_the_start_value_of_the_natural_frequency_holds_until_it_is_estimated() -> None:
    one = run(STEADY)
    one.monitor.set_natural_frequency(17.25)
    before = one.monitor.health.natural_frequency
    assert before.value == 17.25
    assert before.validity is Validity.HELD
    one.go(10.0)
    after = one.monitor.health.natural_frequency
    assert after.validity is Validity.VALID
    assert after.standard_deviation > 0.0


def test_five_minutes_need_no_more_memory_than_one() -> None:
    """At 200 Hz, with a lost and a refused block every minute."""
    monitor = Monitor()
    estimator = Estimator(settings_for(find_valve("4weh10_soft")))
    rate, size = 200.0, 50
    wave = 8.0 * np.sin(2.0 * math.pi * 25.0 * np.arange(size) / rate)
    sizes = []
    sequence = 0
    for number in range(round(300 * rate / size)):
        if number % 240 == 60:
            sequence += 1
        block = Block(
            START + number * 250_000_000,
            sequence,
            1.0 / rate,
            wave.astype(np.float32),
            (0.7 * wave).astype(np.float32),
        )
        sequence += 1
        if number % 240 == 120:
            monitor.update(replace(block, spool=block.spool[:3]))
        monitor.update(block)
        for estimate in estimator.update(block):
            monitor.update_estimate(estimate)
        if number in (240, 1_190):
            sizes.append((len(pickle.dumps(monitor)), len(monitor.gate.faults)))
    assert sizes[1][1] == sizes[0][1] == 2
    # Counters grow by a byte or two as numbers do.
    assert abs(sizes[1][0] - sizes[0][0]) < 200


def test_a_limit_that_there_is_not_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match=r"no limit 'gain_chnge'; there are: .*gain_change"):
        Monitor(MonitorSettings(gain_chnge=0.2))


@pytest.mark.parametrize(
    ("ahead", "reading", "cause", "shown"),
    [
        (0.0, 293.15, "temperature_unit", "Oil temperature unit: oil temperature 293 °C, limit 200 °C"),
        (0.0, math.nan, "temperature_range", "Impossible oil temperature: 3"),
        (
            0.0,
            -242.0,
            "temperature_range",
            "Impossible oil temperature: oil temperature -242 °C, limit -60 °C",
        ),
        (-math.inf, 20.0, "temperature_stamp", "Oil temperature stamp: 3"),
        (3600.0, 20.0, "temperature_stamp", "age of the temperature -3600 s, limit -60 s"),
    ],
)
def test_an_oil_temperature_that_is_not_used_is_reported_with_its_cause_until_one_is(
    ahead: float, reading: float, cause: str, shown: str
) -> None:
    monitor, events = Monitor(MonitorSettings(natural_frequency=15.15)), list[Event]()
    for number, block in enumerate(blocks(80.0)):
        events += monitor.update(block)
        if number % 50 == 0:
            stamp = 0 if math.isinf(ahead) else block.stamp + round(ahead * 1e9)
            unusable = 250 <= number < 500
            events += monitor.update_temperature(
                stamp if unusable else block.stamp, reading if unusable else 20.0
            )
    told = [event for event in events if event.kind == "data_fault"]
    assert [(event.cause, event.state) for event in told] == [
        (cause, EventState.RAISED), (cause, EventState.CLEARED),
    ]  # fmt: skip
    assert shown in headline(told[0])
    assert told[0].source == cause
