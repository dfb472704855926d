"""A valve that its solenoid switches: judged between the strokes, and by their times."""

from __future__ import annotations

from functools import lru_cache

import pytest
from spool_core.block import Block
from spool_core.cdr import Command
from spool_estimator.estimate import State
from spool_estimator.estimator import Estimator, settings_for
from spool_monitor.detectors import Judgement, MonitorSettings
from spool_monitor.event import Event, EventState
from spool_monitor.monitor import Monitor
from spool_monitor.monitor_node import condition_status
from spool_monitor.replay import Replay
from spool_sim.excitation import MachineOrders
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.strokes import Strokes
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft")
MACHINE = MachineOrders(
    speed_profile=((0.0, 1440.0),), orders=((1.0, 5.0), (2.0, 1.75)), broadband_rms=1.0, broadband_low=6.0,
    broadband_high=120.0, broadband_lines=40, seed=3,
)  # fmt: skip
OFTEN = Strokes(period=3.0, first=25.0, hold=0.3)


def simulator(strokes: Strokes) -> Simulator:
    noisy = Sensor(noise=0.05)
    return Simulator(
        VALVE, MACHINE, coulomb_force=0.1, seed=3, body_sensor=noisy, spool_sensor=noisy,
        strokes=strokes,
    )  # fmt: skip


def replay() -> Replay:
    return Replay(Estimator(settings_for(VALVE)), Monitor(MonitorSettings(natural_frequency=15.15)))


def raised(events: list[Event]) -> list[tuple[str, str]]:
    return [(one.kind, one.cause) for one in events if one.state is EventState.RAISED]


@lru_cache(maxsize=1)
def healthy() -> tuple[Replay, tuple[Block, ...]]:
    blocks = tuple(simulator(OFTEN).records(60.0))
    one = replay()
    one.run(blocks)
    return one, blocks


def test_a_healthy_valve_that_is_switched_raises_nothing_and_is_judged() -> None:
    one, _ = healthy()
    assert raised(one.events) == []
    assert one.monitor.detection.judgements["friction_drift"] is Judgement.JUDGED
    assert one.estimator.latest is not None
    assert one.estimator.latest.state is State.TRACKING
    assert one.estimator.latest.parameter("spring_stiffness").value == pytest.approx(1632.0, rel=0.01)


def test_the_summary_says_how_often_it_was_switched_and_how_long_it_was_judged() -> None:
    one, _ = healthy()
    health = one.monitor.health
    assert 20 <= one.monitor.strokes.count <= 24
    share = f"{one.monitor.strokes.share:.0%}"
    assert f"; switched {one.monitor.strokes.count} times today, judged {share} of the time" in health.summary


def test_the_time_of_strokes_is_shown_beside_that_of_the_healthy_valve_and_its_limit() -> None:
    """On the page by the summary, in `/diagnostics` by numbers."""
    one, source = replay(), simulator(Strokes(period=1.5, first=20.0, hold=0.3))
    one.run(source.records(75.0))
    values = condition_status(one.monitor, one.monitor.health).values
    ends = ("", "_healthy", "_low", "_high")
    now, healthy, low, high = (values[f"stroke_time{end}_s"] for end in ends)
    assert healthy == one.monitor.detection.learned["stroke_time"].value
    assert 0.5 * healthy < low < now < high < 1.5 * healthy
    text = f"; stroke time {1e3 * now:.1f} ms (healthy {1e3 * healthy:.1f} ms, limit {1e3 * high:.1f} ms)"
    assert text in one.monitor.health.summary
    assert values["strokes_today"] == one.monitor.strokes.count
    assert values["judged_share"] == one.monitor.strokes.share


def test_wear_of_a_valve_that_is_switched_is_found() -> None:
    source = simulator(OFTEN)
    one = replay()
    one.run(source.records(40.0))
    source.set_drift("viscous_coefficient", 0.7 * VALVE.viscous_coefficient, 1.0)
    one.run(source.records(25.0))
    assert raised(one.events) == [("friction_drift", "wear")]


def test_strokes_that_become_slower_are_reported_within_fifty() -> None:
    source = simulator(Strokes(period=1.5, first=20.0, hold=0.3, force=20.0))
    one = replay()
    one.run(source.records(75.0))
    assert raised(one.events) == []
    before = one.monitor.detection.learned["stroke_time"].value
    source.strokes = Strokes(period=1.5, first=20.0, hold=0.3, force=15.5)
    one.run(source.records(75.0))
    assert ("stroke", "slower") in raised(one.events)
    event = next(one for one in one.events if one.kind == "stroke")
    assert event.facts.value / before > 1.08
    assert event.facts.parameter == "stroke_time"


def test_a_limit_that_changes_decides_how_severe_slower_strokes_are() -> None:
    severities = []
    for limit in (0.05, 0.5):
        source, one = simulator(Strokes(period=1.5, first=20.0, hold=0.3, force=20.0)), replay()
        one.run(source.records(70.0))
        one.monitor.set_limits(MonitorSettings(natural_frequency=15.15, stroke_change=limit))
        source.strokes = Strokes(period=1.5, first=20.0, hold=0.3, force=13.0)
        one.run(source.records(50.0))
        severities += [max(event.severity for event in one.events if event.kind == "stroke").name]
    assert severities == ["ALARM", "WARNING"]


def test_a_record_of_commands_gives_the_delay_of_each_stroke() -> None:
    source, one, delays, before = simulator(OFTEN), replay(), [], 0.0
    for _ in range(50 * 32):
        command = source.command
        if command != before:
            item = Command(source.stamp, command)
            one.update_command(item.stamp, item.value)
            before = command
        one.update(source.next_block())
        one.flush()
        delays += [stroke.delay for stroke in one.monitor.strokes.strokes if stroke.out]
    assert len(delays) == 3
    assert all(0.0 < delay < 0.02 for delay in delays)
