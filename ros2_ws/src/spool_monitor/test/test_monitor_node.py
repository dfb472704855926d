"""What the monitor's node publishes: it runs in this process and takes messages as fast as it can."""

from __future__ import annotations

import math
import re
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pytest
import rclpy
from rclpy.clock import ClockType
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.time import Time
from spool_core.block import Block
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import headline
from spool_core.kernels.strokes import Stroke
from spool_core.node import qos
from spool_core.node.diagnostics import key
from spool_core.node.managed_node import HostContext
from spool_core.node.messages import from_event_message, nanoseconds
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.messages import to_description, to_message
from spool_monitor.journal import entries_in
from spool_monitor.monitor_node import MonitorNode
from spool_monitor.state_database import FILE
from spool_monitor.state_file import valve_folder
from spool_msgs.msg import Alarm, HealthEvent, ValveHealth
from spool_msgs.srv import ManageBaseline, SuppressAlarm
from spool_sim.excitation import PRESETS
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.valve import Valve, find_valve

VALVE = find_valve("4weh10_soft")
START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
#: What the node's clock is ahead of the stamps of its data, ns.
AHEAD = 1_000 * SECOND
BLOCKS = "/valve_1/acceleration"
HOST = HostContext()
#: What is estimated of the valve.
TRUE = {
    "viscous_coefficient": VALVE.viscous_coefficient, "coulomb_force": 0.1,
    "spring_stiffness": VALVE.spring_stiffness,
}  # fmt: skip
#: s that a test waits at most: machines are busy.
PATIENCE = 180.0

#: Numbers without a unit, and the units of the others.
RATIOS = ("amplification", "viscous_coefficient_change", "reversals")
UNITS = "_(N|N_per_m|N_s_per_m|Hz|deg_C|m|B)"

#: A block and the estimates that fall due with it.
Step: TypeAlias = tuple[Block, tuple[Estimate, ...]]


@cache
def healthy() -> tuple[Step, ...]:
    """Return 30 s of a healthy valve at 10 blocks a second, simulated once."""
    noisy = Sensor(noise=0.03)
    simulator = Simulator(
        VALVE, PRESETS["multisine"], coulomb_force=0.1, seed=5, sample_rate=500.0, block_size=50,
        body_sensor=noisy, spool_sensor=noisy, start_stamp=START,
    )  # fmt: skip
    estimator, steps = Estimator(settings_for(VALVE, period=0.5, memory=2.0)), list[Step]()
    for number in range(300):
        block = replace(simulator.next_block(), source=VALVE.id)
        if number % 10 == 0:
            estimator.update_temperature(block.stamp, VALVE.oil_temperature + 0.001 * number)
        steps.append((block, tuple(estimator.update(block))))
    return tuple(steps)


class DrivenMonitor(MonitorNode):
    """Monitor of `valve_1`, active. ``sent`` has its messages by topic, ``now`` (ns) is its clock."""

    def __init__(self, context: Context, **parameters: Any) -> None:
        self.sent: dict[str, list[Any]] = defaultdict(list)
        self._inputs: dict[str, Callable[[Any], None]] = {}
        self._due: list[Callable[[], None]] = []
        self._answers: dict[str, tuple[Any, Callable[[Any, Any], Any]]] = {}
        values = {"use_sim_time": True, "state_folder": "none", "baseline_time": 4.0, **parameters}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        super().__init__(
            "valve_1", host=HOST, context=context, parameter_overrides=overrides, enable_rosout=False
        )
        self.now = START + AHEAD
        assert self.trigger_configure() == self.trigger_activate() == TransitionCallbackReturn.SUCCESS

    @property
    def now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    @now.setter
    def now(self, stamp: int) -> None:
        self.get_clock().set_ros_time_override(Time(nanoseconds=stamp, clock_type=ClockType.ROS_TIME))

    def create_publisher(self, kind: Any, topic: str, *more: Any, **named: Any) -> Any:
        return self._kept(super().create_publisher(kind, topic, *more, **named), kind, topic)

    def create_lifecycle_publisher(self, kind: Any, topic: str, *more: Any, **named: Any) -> Any:
        return self._kept(super().create_lifecycle_publisher(kind, topic, *more, **named), kind, topic)

    def _kept(self, publisher: Any, kind: Any, topic: str) -> Any:
        send = publisher.publish

        def publish(message: Any) -> None:
            self.sent[topic].append(deserialize_message(serialize_message(message), kind))
            send(message)

        publisher.publish = publish
        return publisher

    def subscribe(self, kind: Any, topic: str, callback: Any, *more: Any, **named: Any) -> Any:
        self._inputs[topic] = callback
        return super().subscribe(kind, topic, callback, *more, **named)

    def every(self, period: float, callback: Callable[[], None], **named: Any) -> Any:
        self._due.append(callback)
        return super().every(period, callback, **named)

    def create_service(self, kind: Any, name: str, answer: Any, **named: Any) -> Any:
        self._answers[name] = kind, answer
        return super().create_service(kind, name, answer, **named)

    def hear(self, topic: str, message: Any) -> None:
        """Take a message of a topic."""
        self._inputs[topic](message)

    def take(self, steps: Iterable[Step]) -> None:
        """Take blocks and estimates, and report."""
        for block, estimates in steps:
            HOST.hub.hand_over(BLOCKS, block)
            for one in estimates:
                self.hear("estimate", to_message(one, VALVE.id))
        self.look()

    def look(self) -> None:
        """Do what it does every second, and more often."""
        for one in self._due:
            one()

    def ask(self, service: str, **fields: object) -> Any:
        """Call a service."""
        kind, answer = self._answers[f"~/{service}"]
        return answer(kind.Request(**fields), kind.Response())

    def tasks(self) -> dict[str, dict[str, str]]:
        """Return the values of each task in the last report of `/diagnostics`."""
        last = self.sent["/diagnostics"][-1]
        return {
            one.name.partition(": ")[2]: {pair.key: pair.value for pair in one.values} for one in last.status
        }


@pytest.fixture(scope="module", name="context")
def _context() -> Iterator[Context]:
    made = Context()
    rclpy.init(context=made)
    HOST.hub.offer(BLOCKS)
    yield made
    HOST.hub.withdraw(BLOCKS)
    rclpy.shutdown(context=made)


@pytest.fixture(name="start")
def _start(context: Context) -> Iterator[Callable[..., DrivenMonitor]]:
    """Start a monitor that knows its valve; one that was started before is gone then, as if killed."""
    started: list[DrivenMonitor] = []

    def end() -> None:
        for one in started:
            one.trigger_shutdown()
            one.destroy_node()
        started.clear()

    def start(valve: Valve = VALVE, **parameters: Any) -> DrivenMonitor:
        end()
        node = DrivenMonitor(context, **parameters)
        started.append(node)
        node.hear("valve", to_description(valve))
        return node

    yield start
    end()


# Parameters that change while it runs.

Change: TypeAlias = Callable[[float, Block, tuple[Estimate, ...]], Step]


def drifted(name: str, factor: float) -> Change:
    """Let a parameter's estimates be ``factor`` times as large."""

    def other(one: Quantity) -> Quantity:
        return replace(one, value=factor * one.value) if one.name.endswith(name) else one

    def change(_: float, block: Block, estimates: tuple[Estimate, ...]) -> Step:
        changed = [
            replace(
                one,
                parameters=tuple(map(other, one.parameters)),
                referred_viscous_coefficient=other(one.referred_viscous_coefficient),
            )
            for one in estimates
        ]
        return block, tuple(changed)

    return change


def line(ratio: float, *gains: float) -> Change:
    """Shake the body with 3 m/s^2 at ``ratio`` of the natural frequency; the spool has each gain for 4 s."""

    def change(seconds: float, block: Block, _: tuple[Estimate, ...]) -> Step:
        time = seconds + block.sample_period * np.arange(block.body.size)
        angle = 2.0 * np.pi * ratio * VALVE.natural_frequency * time
        gain = gains[min(int(seconds / 4.0), len(gains) - 1)]
        body, spool = 3.0 * np.sin(angle), -3.0 * gain * np.cos(angle)
        body, spool = (np.float32(one + 0.01 * of) for one, of in ((body, block.body), (spool, block.spool)))
        return replace(block, body=body, spool=spool), ()

    return change


def offset(_: float, block: Block, estimates: tuple[Estimate, ...]) -> Step:
    """Let the spool's sensor show 0.8 m/s^2 more."""
    return replace(block, spool=block.spool + np.float32(0.8)), estimates


def scaled(_: float, block: Block, estimates: tuple[Estimate, ...]) -> Step:
    """Let the spool's sensor show 1.25 times what it should, which no valve explains."""
    residual = Quantity("residual", "1", 0.5, validity=Validity.VALID)
    spool = np.float32(1.25) * block.spool
    return replace(block, spool=spool), tuple(replace(one, residual=residual) for one in estimates)


def stuck(_: float, block: Block, estimates: tuple[Estimate, ...]) -> Step:
    """Let the spool move with its body."""
    return replace(block, spool=block.body + 0.01 * block.spool), estimates


def silent(seconds: float, block: Block, estimates: tuple[Estimate, ...]) -> Step:
    """Let 3 s be lost."""
    number = 0 if seconds == 0.0 else 30
    return replace(block, stamp=block.stamp + number * SECOND // 10, sequence=block.sequence + number), ()


class Case(NamedTuple):
    """What changes after ``lead`` s of a healthy valve: only with the first value it brings ``event``."""

    change: Change
    values: tuple[float, float]
    event: tuple[str, str, int, int]
    lead: int = 12


RAISED, CLEARED = HealthEvent.STATE_RAISED, HealthEvent.STATE_CLEARED
WARNING, ALARM = HealthEvent.SEVERITY_WARNING, HealthEvent.SEVERITY_ALARM
RESONANCE, WORN = ("resonance", "", RAISED, WARNING), ("friction_drift", "wear", RAISED, WARNING)
CASES = {
    "minimum_body": Case(line(1.0, 2.5), (2.9, 3.3), RESONANCE, 0),
    "resonance_band": Case(line(1.1, 2.5), (0.12, 0.08), RESONANCE, 0),
    "resonance_on_delay": Case(line(1.0, 2.5), (2.0, 60.0), RESONANCE, 0),
    "amplification_on": Case(line(1.0, 2.5), (2.4, 2.6), RESONANCE, 0),
    "amplification_off": Case(line(1.0, 2.5, 1.6), (1.7, 1.5), ("resonance", "", CLEARED, WARNING), 0),
    "false_alarm_interval": Case(drifted("viscous_coefficient", 0.93), (0.1, 36_500.0), WORN),
    "friction_drift_on_delay": Case(drifted("viscous_coefficient", 0.75), (4.0, 60.0), WORN),
    # Twice the limit is an alarm.
    "viscous_change": Case(drifted("viscous_coefficient", 0.7), (0.1, 0.2), (*WORN[:3], ALARM)),
    "coulomb_change": Case(
        drifted("coulomb_force", 1.9), (0.03, 0.06), ("friction_drift", "oil_contamination", RAISED, ALARM)
    ),
    "stiffness_change": Case(
        drifted("spring_stiffness", 0.85), (0.05, 0.1), ("spring_change", "softer", RAISED, ALARM)
    ),
    "spring_change_on_delay": Case(
        drifted("spring_stiffness", 0.85), (4.0, 60.0), ("spring_change", "softer", RAISED, WARNING)
    ),
    "offset_change": Case(offset, (0.7, 0.9), ("sensor_fault", "offset", RAISED, WARNING)),
    "gain_change": Case(scaled, (0.2, 0.3), ("sensor_fault", "scale", RAISED, ALARM)),
    "stuck_spool_on_delay": Case(stuck, (4.0, 60.0), ("stuck_spool", "", RAISED, ALARM)),
    "stale_after": Case(silent, (2.9, 3.1), ("stale", "acceleration", RAISED, ALARM)),
}


@pytest.mark.parametrize(
    "name",
    [
        one.name
        for one in MonitorNode.PARAMETERS
        # It needs strokes: see below.
        if not (one.structural or one.read_only or one.name == "stroke_change")
    ],
)
def test_a_limit_that_changes_while_the_monitor_runs_decides_what_is_reported(
    name: str, start: Callable[..., DrivenMonitor]
) -> None:
    case, found = CASES[name], []
    for value in case.values:
        node = start()
        node.take(healthy()[: 10 * case.lead])
        (answer,) = node.set_parameters([Parameter(name, value=value)])
        assert answer.successful
        rest = enumerate(healthy()[10 * case.lead :])
        node.take(case.change(number / 10, *step) for number, step in rest)
        found.append([(one.kind, one.cause, one.state, one.severity) for one in node.sent["events"]])
    assert [case.event in one for one in found] == [True, False]


def test_the_limit_of_stroke_times_changes_while_the_monitor_runs(
    start: Callable[..., DrivenMonitor],
) -> None:
    """Strokes that take a third longer than the healthy ones are an alarm where half of that matters."""
    found = []
    for limit in (0.15, 0.3):
        node, generator = start(), np.random.default_rng(1)
        (answer,) = node.set_parameters([Parameter("stroke_change", value=limit)])
        assert answer.successful
        for number in range(120):
            time = generator.normal(0.02, 0.0002) * (1.0 if number < 60 else 1.33)
            stroke = Stroke(START + 7 * number * SECOND, True, 1, time, math.nan, 0.2, 0.1)
            node._publish(node._core.detection.update_strokes([stroke], VALVE.natural_frequency))
        slower = [one for one in node.sent["events"] if (one.kind, one.cause) == ("stroke", "slower")]
        found.append(max((one.severity for one in slower), default=0))
    assert found == [ALARM, WARNING]


# What outlives the process, and what reaches a listener that joins late.


def test_who_joins_late_hears_the_last_hundred_events(
    start: Callable[..., DrivenMonitor], context: Context
) -> None:
    node = start()
    quiet = healthy()[0][0]

    def lost(first: int, count: int) -> None:
        """Silence of 3 s before each block: it is raised and cleared."""
        for number in range(first, first + count):
            stamp = START + number * 31 * SECOND // 10
            node.take([(replace(quiet, stamp=stamp, sequence=31 * number), ())])

    lost(0, 60)
    listener = Node("listener", context=context)
    heard: list[tuple[Any, str, int]] = []

    def hear(event: HealthEvent) -> None:
        heard.append((event.header.stamp, event.kind, event.state))

    listener.create_subscription(HealthEvent, "/valve_1/events", hear, qos.state(depth=100))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    end = time.monotonic() + PATIENCE
    while node.count_subscribers("events") == 0 and time.monotonic() < end:
        executor.spin_once(0.1)
    lost(60, 1)
    sent = [(one.header.stamp, one.kind, one.state) for one in node.sent["events"]]
    while sent[-1] not in heard and time.monotonic() < end:
        executor.spin_once(0.1)
    executor.shutdown()
    listener.destroy_node()
    assert len(sent) > 110
    assert heard[-100:] == sent[-100:]


@pytest.mark.parametrize(
    ("action", "version", "stage", "who"),
    [("FREEZE", 2, "frozen", "Eva"), ("RESTORE", 1, "learned", ""), ("LEARN", 0, "learning", "")],
)
def test_what_an_operator_did_to_the_baseline_holds_after_a_kill(
    action: str, version: int, stage: str, who: str, tmp_path: Path, start: Callable[..., DrivenMonitor]
) -> None:
    node = start(state_folder=str(tmp_path / "state"))
    node.take(healthy()[:100])
    assert node.ask("manage_baseline", action=ManageBaseline.Request.LEARN, who="Jan").success
    node.take(healthy()[100:200])
    shown = node.ask("manage_baseline", action=ManageBaseline.Request.SHOW)
    assert (shown.version, shown.valve_id, shown.oil) == (2, VALVE.id, VALVE.oil)
    assert [one - VALVE.oil_temperature for one in shown.temperature] == pytest.approx([0.09, 0.13])
    learned = {one.name: one.value for one in shown.values[: len(TRUE)]}
    assert learned == pytest.approx(TRUE, rel=0.02)
    done = node.ask("manage_baseline", action=getattr(ManageBaseline.Request, action), version=1, who="Eva")
    assert (done.success, done.stage) == (True, stage)
    shutil.copytree(tmp_path / "state", tmp_path / "kept")
    node = start(state_folder=str(tmp_path / "kept"))
    found = node.ask("manage_baseline", action=ManageBaseline.Request.SHOW)
    assert (found.version, found.stage, found.frozen_by) == (version, stage, who)
    assert found == done


def test_the_baseline_of_another_valve_is_neither_used_nor_restored(
    tmp_path: Path, start: Callable[..., DrivenMonitor]
) -> None:
    start(state_folder=str(tmp_path)).take(healthy()[:100])
    node = start(find_valve("4weh10_stiff"), state_folder=str(tmp_path))
    assert node.ask("manage_baseline", action=ManageBaseline.Request.SHOW).version == 0
    back = node.ask("manage_baseline", action=ManageBaseline.Request.RESTORE, version=1, who="Eva")
    assert not back.success
    assert "is of valve 4weh10_soft, not of 4weh10_stiff" in back.reason


def resonating() -> list[Step]:
    """Return 6 s in resonance."""
    return [line(1.0, 2.5)(number / 10, *step) for number, step in enumerate(healthy()[:60])]


def resonance(node: DrivenMonitor) -> Any:
    (found,) = (one for one in node.sent["alarms"][-1].alarms if one.kind == "resonance")
    return found


OUT = {"way": SuppressAlarm.Request.OUT_OF_SERVICE}


@pytest.mark.parametrize(
    ("service", "fields", "state", "acts"),
    [
        ("shelve_alarm", {}, Alarm.STATE_SHELVED, ("shelve", "expire")),
        ("suppress_alarm", OUT, Alarm.STATE_OUT_OF_SERVICE, ("remove from service", "return to service")),
    ],
)
def test_what_was_put_aside_for_a_time_comes_back_by_itself_also_across_kills(
    service: str, fields: Any, state: int, acts: Any, tmp_path: Path, start: Callable[..., DrivenMonitor]
) -> None:
    node = start(state_folder=str(tmp_path / "state"))
    node.take(resonating())
    begun = node.now
    asked = {"alarm": "resonance", "duration": 60.0, "who": "Eva", "comment": "pump replacement", **fields}
    assert node.ask(service, **asked).success
    shutil.copytree(tmp_path / "state", tmp_path / "before")
    node = start(state_folder=str(tmp_path / "before"))
    end = begun + 60 * SECOND
    node.now = end - 1
    node.look()
    assert (resonance(node).state, nanoseconds(resonance(node).shelved_until)) == (state, end)
    node.now = end
    node.look()
    assert nanoseconds(node.sent["alarms"][-1].header.stamp) == end
    assert resonance(node).state == Alarm.STATE_UNACKNOWLEDGED
    shutil.copytree(tmp_path / "before", tmp_path / "after")
    node = start(state_folder=str(tmp_path / "after"))
    assert resonance(node).state == Alarm.STATE_UNACKNOWLEDGED
    journal = entries_in(valve_folder(tmp_path / "after", "valve_1") / FILE)[-2:]
    assert [(one.action, one.who, one.stamp, one.comment) for one in journal] == [
        (acts[0], "Eva", begun, "pump replacement"), (acts[1], "", end, ""),
    ]  # fmt: skip


def test_operators_act_on_an_alarm_by_services_or_are_refused_with_the_reason(
    start: Callable[..., DrivenMonitor],
) -> None:
    node = start(latched_kinds=["resonance"])
    node.take(resonating())
    acts: list[tuple[str, dict[str, object], str | int]] = [
        ("acknowledge_alarm", {"who": ""}, "'who' is required: name the operator"),
        ("acknowledge_alarm", {"alarm": "smoke"}, "no alarm 'smoke'; there are: "),
        ("acknowledge_alarm", {"occurrence": 7}, "occurrence 7 is not current; look at number 1 first"),
        ("reset_alarms", {}, "resonance: it is still active, so it can't be reset"),
        ("suppress_alarm", {"way": 9}, "way: 9 is not 0 (by design) or 1 (out of service)"),
        ("shelve_alarm", {}, Alarm.STATE_SHELVED),
        ("shelve_alarm", {"shelved": False}, Alarm.STATE_UNACKNOWLEDGED),
        ("suppress_alarm", {}, Alarm.STATE_SUPPRESSED),
        ("suppress_alarm", {"suppressed": False}, Alarm.STATE_UNACKNOWLEDGED),
        ("suppress_alarm", OUT, Alarm.STATE_OUT_OF_SERVICE),
        ("suppress_alarm", {**OUT, "suppressed": False}, Alarm.STATE_UNACKNOWLEDGED),
        ("acknowledge_alarm", {"alarm": ""}, Alarm.STATE_ACKNOWLEDGED),
    ]
    for service, fields, result in acts:
        answer = node.ask(service, **{"alarm": "resonance", "who": "Eva", **fields})
        if isinstance(result, str):
            assert (answer.success, result in answer.reason) == (False, True), answer.reason
        else:
            assert (answer.success, resonance(node).state) == (True, result), service
    node.take(healthy()[60:120])
    assert node.ask("reset_alarms", who="Eva").success
    assert resonance(node).state == Alarm.STATE_NORMAL


def test_an_acknowledgement_survives_a_kill_and_the_end_of_the_alarm_is_seen_after_it(
    tmp_path: Path, start: Callable[..., DrivenMonitor]
) -> None:
    node = start(state_folder=str(tmp_path / "state"))
    node.take(resonating())
    assert node.ask("acknowledge_alarm", alarm="resonance", who="Eva", comment="I look").success
    shutil.copytree(tmp_path / "state", tmp_path / "kept")
    node = start(state_folder=str(tmp_path / "kept"))
    alarm = resonance(node)
    assert (alarm.state, alarm.acknowledged_by, alarm.comment) == (Alarm.STATE_ACKNOWLEDGED, "Eva", "I look")
    node.take(healthy()[60:120])
    assert [(one.kind, one.state) for one in node.sent["events"]] == [("resonance", CLEARED)]
    assert resonance(node).state == Alarm.STATE_NORMAL
    # An aggregator has its task from before, which would be STALE forever.
    shutil.copytree(tmp_path / "kept", tmp_path / "later")
    node = start(state_folder=str(tmp_path / "later"))
    node.look()
    assert node.tasks()["alarm resonance"]["state"] == "normal"


def test_language_latched_kinds_and_natural_frequency_hold_from_the_start(
    start: Callable[..., DrivenMonitor], capfd: pytest.CaptureFixture[str]
) -> None:
    node = start(language="de", latched_kinds=["resonance"])
    node.take([*resonating(), *healthy()[60:120]])
    (logged,) = (line for line in capfd.readouterr().err.splitlines() if "warning 100 resonance: " in line)
    assert logged.startswith("[WARN]")
    first = from_event_message(node.sent["events"][0])
    assert node.sent["events"][0].message == headline(first, LANGUAGES["de"]) != headline(first)
    assert resonance(node).state == Alarm.STATE_LATCHED_UNACKNOWLEDGED
    node = start(natural_frequency=30.0)
    node.take(resonating())
    assert node.sent["events"] == []


def test_limits_that_contradict_each_other_are_refused_together_and_change_nothing(
    start: Callable[..., DrivenMonitor],
) -> None:
    node = start()
    (answer,) = node.set_parameters([Parameter("amplification_off", value=1.8)])
    assert not answer.successful
    assert "amplification_off (1.8) must lie below amplification_on (1.8)" in answer.reason
    assert node.value("amplification_off") == 1.5
    both = [Parameter("amplification_off", value=1.9), Parameter("amplification_on", value=2.5)]
    assert node.set_parameters_atomically(both).successful


def test_diagnostics_have_the_counts_and_the_numbers_of_what_was_published(
    tmp_path: Path, start: Callable[..., DrivenMonitor]
) -> None:
    """Of 90 s 23 blocks were lost and 3 refused, 20 and 1 of them within the last minute: a silence."""
    node = start(state_folder=str(tmp_path))
    later = [
        (replace(one, stamp=one.stamp + turn * 30 * SECOND, sequence=one.sequence + turn * 300), estimates)
        for turn in range(3)
        for one, estimates in healthy()
        for estimates in ([estimates] if turn == 0 else [()])
    ]
    broken = [(replace(one, body=one.body * np.float32("nan")), ()) for one, _ in later]
    node.take([*later[:120], *broken[123:125], *later[123:850], broken[870], *later[870:]])
    for name in ("stuck_spool", "resonance", "spring_change"):
        assert node.ask("shelve_alarm", alarm=name, duration=60.0, who="Eva").success
    assert len(node.ask("suppress_alarm", alarm="sensor_fault", who="Eva").changed) == 13
    for name in ("friction_drift", "stale/estimate", "data_fault/rate", "data_fault/source"):
        way = SuppressAlarm.Request.OUT_OF_SERVICE
        assert node.ask("suppress_alarm", alarm=name, way=way, who="Eva").success
    node.look()
    assert node.tasks()["alarms"]["waiting"] == "3"
    assert node.ask("acknowledge_alarm", who="Eva").success
    node.look()
    tasks, health = node.tasks(), node.sent["health"][-1]
    assert {node.sent[topic][-1].header.frame_id for topic in ("alarms", "events", "health")} == {VALVE.id}
    assert nanoseconds(health.header.stamp) == later[-1][0].end
    for one in node.sent["/diagnostics"][-1].status:
        assert len({pair.key for pair in one.values}) == len(one.values), one.name
        for pair in one.values:  # a number has a unit, or its name says what is counted
            number = re.fullmatch(r"-?(\d+\.\d*|\d+e.*|nan|inf)", pair.value) and pair.key not in RATIOS
            assert re.fullmatch(rf"[a-z][a-z0-9_]*{UNITS if number else '[A-Za-z0-9_]*'}", pair.key)
    data = {name: int(value) for name, value in tasks["data"].items() if value.isdecimal()}
    assert {name: value for name, value in data.items() if value} == {
        "blocks_used": 877, "blocks_lost": 23, "blocks_refused": 3, "blocks_lost_last_minute": 20,
        "blocks_refused_last_minute": 1, "fault_lost": 2, "fault_not_finite": 3,
    }  # fmt: skip
    alarms = {name: int(value) for name, value in tasks["alarms"].items() if value.isdecimal()}
    assert alarms.pop("reversals") > 1000
    assert alarms == {
        "active": 2, "waiting": 0, "latched": 0, "shelved": 3, "suppressed": 13, "out_of_service": 6,
    }  # fmt: skip
    assert 1.0 < float(tasks["alarms"]["travel_m"]) < 10.0
    assert (health.namur, tasks["alarms"]["ne_107"]) == (ValveHealth.NAMUR_FUNCTION_CHECK, "C function check")
    told = {name: task["code"] for name, task in tasks.items() if name.startswith("alarm data_fault/")}
    assert told["alarm data_fault/lost"] == "703"
    assert told["alarm data_fault/malformed/samples"] == "704"
    shown = (health.dominant_frequency, health.amplification, health.natural_frequency)
    changes = (health.viscous_drift, health.coulomb_drift)
    condition = tasks["condition"]
    assert {one.name for one in changes} == {"viscous_coefficient_change", "coulomb_force_change"}
    for one in (*shown, *changes):
        assert float(condition[key(one.name, one.unit)]) == pytest.approx(one.value, rel=1e-5), one.name
    baseline = node.ask("manage_baseline", action=ManageBaseline.Request.SHOW)
    for one in baseline.values[:3]:
        low, high = (float(condition[key(f"{one.name}_{end}", one.unit)]) for end in ("low", "high"))
        assert 0.7 * one.value < low < one.value < high < 1.3 * one.value, one.name
