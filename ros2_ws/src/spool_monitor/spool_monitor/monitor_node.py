"""Node of the monitor: parameters, topics, and the services of its alarms."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from sensor_msgs.msg import Temperature
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Fault, Verdict
from spool_core.errors import InputError
from spool_core.events.language import Language
from spool_core.events.sentences import headline, language_of
from spool_core.node import qos
from spool_core.node.block_hub import Silence, waiting_for_disk
from spool_core.node.diagnostics import DiagnosticPublisher, Level, Status, block_faults, block_values, key
from spool_core.node.managed_node import ManagedNode
from spool_core.node.messages import nanoseconds, to_event_message, to_quantity, to_time
from spool_core.node.parameters import LANGUAGE, NodeParameter, Value
from spool_core.one_source import Standing
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate
from spool_estimator.messages import from_description, from_message
from spool_msgs.msg import Alarm as AlarmMessage
from spool_msgs.msg import AlarmList, HealthEvent, ModelEstimate, ValveDescription, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, SuppressAlarm
from std_msgs.msg import Float64

from spool_monitor import alarm as acts
from spool_monitor.alarm import Action, Alarm, AlarmRefusedError, AlarmState, Operator, Transition
from spool_monitor.alarm_store import AlarmStore
from spool_monitor.detection import Detection
from spool_monitor.detectors import JUDGEMENT_TEXTS, KINDS, LIMITS, check_settings, latching_kinds
from spool_monitor.detectors.base import NATURAL_FREQUENCY, Judgement, MonitorSettings
from spool_monitor.detectors.stale import KIND as STALE
from spool_monitor.estimate_gate import Descriptions
from spool_monitor.event import Event, Namur, Severity
from spool_monitor.journal import DAYS, JournalEntry
from spool_monitor.listener import ENDS
from spool_monitor.monitor import Health, HealthLevel, Monitor
from spool_monitor.state_database import FILE
from spool_monitor.state_file import default_folder, valve_folder
from spool_monitor.trend_writer import TrendWriter
from spool_monitor.valve_state import ValveState, entries_of
from spool_monitor.warm_up import warm_up_monitor

_SETTINGS = tuple(
    NodeParameter(
        limit.name, limit.default, limit.description, limit.unit, limit.minimum, limit.maximum,
        structural=limit.structural,
    )
    for limit in LIMITS.values()
)  # fmt: skip

_KEEPING = (
    NodeParameter(
        "state_folder", "",
        "Folder for alarms, baseline and trends, with a subfolder for each valve; empty: "
        "$XDG_STATE_HOME/spool, else ~/.local/state/spool; none: store nothing.",
        structural=True,
    ),
    NodeParameter(
        "journal_days", DAYS, "How long the journal of alarms and of operators' acts is kept.", "d",
        1.0, 3660.0, structural=True,
    ),
    NodeParameter(
        "latched_kinds", list(latching_kinds()), "Kinds of events whose alarms stay until they are reset.",
        structural=True,
    ),
)  # fmt: skip

#: s that an estimator of the same namespace may take to start: kernels of several nodes may be compiled, one
#: after the other. Once it was heard, or without one, silence is reported immediately.
STARTS = 180.0

#: s between two looks at what arrives: chosen, silence is noticed later by that.
LOOK = 0.2

#: What a fault code of ros2_medkit's fault manager can't hold, and how many characters it may have.
_FAULT_CODE, LONGEST_FAULT_CODE = re.compile(r"[^A-Za-z0-9_-]+"), 128

_QUANTITIES = ("dominant_frequency", "amplification", "natural_frequency", "viscous_drift", "coulomb_drift")

_ALARM_FIELDS = ("name", "kind", "cause", "code", "occurrence", "acknowledged_by", "comment")

#: Of an active condition that is worst; without one all is well.
_LEVELS = {None: Level.OK, Severity.WARNING: Level.WARNING, Severity.ALARM: Level.ERROR}


class MonitorNode(ManagedNode):
    """Node ``monitor``: judges resonance, drift and silence of one valve from its blocks and estimates."""

    PARAMETERS: ClassVar = (*_SETTINGS, *_KEEPING, LANGUAGE)

    def __init__(self, namespace: str | None = None, **options: Any) -> None:
        super().__init__("monitor", namespace, **options)
        self._core: Monitor
        self._alarms: AlarmServices
        self._trends: TrendWriter | None = None
        self._valve_id = self.get_namespace().strip("/")
        self._described = False
        self._descriptions = Descriptions[ValveDescription]()
        self._activated = time.monotonic()
        self._no_blocks, self._no_estimates = Silence(2.0 * LOOK), Silence(2.0 * LOOK)
        self._level = HealthLevel.UNKNOWN

    def configure(self) -> None:
        """Build the core; its kernels are compiled here, not at the first sample."""
        self.compile(warm_up_monitor)
        self._core = Monitor(self._settings({}))
        self._described, self._descriptions = False, Descriptions()
        kinds = tuple(kind for kind in self.value("latched_kinds") if kind)
        warn = self.get_logger().warning
        days = float(self.value("journal_days"))
        state = ValveState(self._core, self._folder(), warn, AlarmStore(kinds), days)
        state.open()
        self._language = language_of(self.value(LANGUAGE.name))
        self._alarms = AlarmServices(self, state, self._language)
        if state.folder is not None:
            self._trends = TrendWriter(state.folder / FILE, warn, lambda: state.owned)
        self._health_publisher = self.create_lifecycle_publisher(ValveHealth, "health", qos.state())
        self._event_publisher = self.create_lifecycle_publisher(HealthEvent, "events", qos.state(depth=100))
        self._diagnostics = DiagnosticPublisher(self, self._valve_id)
        kept = "nowhere" if state.folder is None or not state.writable else f"in {state.folder}"
        self.get_logger().info(f"configured: alarms and baseline are kept {kept}")

    def activate(self) -> None:
        """Listen; estimates and the valve's description are latched, so a late start misses neither."""
        self._activated = time.monotonic()
        self._no_blocks.end()
        self._no_estimates.end()
        self._core.gate.resume()
        self._core.estimates.resume()
        self._alarms.show()
        self.subscribe(ValveDescription, "valve", self._take_description, qos.state())
        self.subscribe_blocks("acceleration", self._take_blocks, self._room)
        self.subscribe(ModelEstimate, "estimate", self._take_estimate, qos.state(depth=10))
        for topic, take in (("speed", self._core.update_speed), ("command", self._core.strokes.take_command)):
            self.subscribe(Float64, topic, partial(self._take_number, take), qos.samples_wanted())
        self.subscribe(Temperature, "oil_temperature", self._take_temperature, qos.samples_wanted())
        self.every(LOOK, self._watch, steady=True)
        self.every(1.0, self._report, steady=True)

    def deactivate(self) -> None:
        """Publish that the valve is not judged: its last level would stay latched."""
        health = replace(
            self._health(), level=HealthLevel.UNKNOWN, namur=Namur.UNKNOWN, active=(), judgements=(),
            summary="not monitored: the monitor is inactive",
        )  # fmt: skip
        self._level = health.level
        self._health_publisher.publish(to_health_message(health, self._valve_id))
        self._diagnostics.rest(health.summary, "data", "condition")  # alarms that stand are no less there

    def cleanup(self) -> None:
        """Release core and publishers."""
        self.destroy_publisher(self._health_publisher)
        self.destroy_publisher(self._event_publisher)
        self._diagnostics.destroy()
        if self._trends is not None:
            self._trends.close()  # before the folder is another monitor's to write in
        self._trends = None
        self._alarms.close()

    def refuse_change(self, changes: dict[str, Value]) -> str | None:
        """Refuse limits that contradict each other, and kinds that there are not."""
        try:
            check_settings(self._settings(changes))
        except InputError as error:
            return str(error)
        kinds = changes.get("latched_kinds", [])
        unknown = [kind for kind in kinds if kind and kind not in KINDS] if isinstance(kinds, list) else []
        return f"latched_kinds: {unknown[0]!r} is not one of {', '.join(KINDS)}" if unknown else None

    def apply_change(self, changes: dict[str, Value]) -> None:
        """Judge by the new limits from now on."""
        if self._configured and LIMITS.keys() & changes.keys():
            self._core.set_limits(self._settings({}))

    def _settings(self, changes: dict[str, Value]) -> MonitorSettings:
        values: dict[str, Any] = {
            parameter.name: changes.get(parameter.name, self.value(parameter.name)) for parameter in _SETTINGS
        }
        return MonitorSettings(**values)

    def _folder(self) -> Path | None:
        """Return where this valve's state is kept, ``None`` for nowhere."""
        given = self.value("state_folder")
        if given == "none":
            return None
        try:
            base = Path(given).expanduser() if given else default_folder()
        except RuntimeError:
            self.get_logger().warning(
                "no home directory: alarms and baseline are not saved; set state_folder"
            )
            return None
        return valve_folder(base, self.get_namespace())

    def _take_description(self, message: ValveDescription) -> None:
        """Take the valve's description; while estimates of another one are used it waits for its own."""
        name, before = message.header.frame_id, self._descriptions.used
        if self._descriptions.take(name, message, self._core.estimates.last) is not None:
            self._describe(message)
        elif name != before:
            self.get_logger().warning(
                f"valve: the description of {name} waits for its estimates; the present ones are of {before}"
            )

    def _describe(self, message: ValveDescription) -> None:
        self._valve_id = self._diagnostics.valve_id = message.header.frame_id
        if not self._described:
            self._described = True
            self._no_estimates.end()  # the estimator begins now
        self._alarms.identify(message.header.frame_id, message.oil)
        if self.value(NATURAL_FREQUENCY.name) == 0.0:
            self._core.set_natural_frequency(from_description(message).natural_frequency)
        if message.components:
            self._core.detection.orders.components = from_description(message).components

    def _room(self) -> int:
        last = self._core.gate.last
        return self._core.room(last.period if last is not None else 0.0)

    def _take_blocks(self, blocks: Sequence[Block]) -> None:
        gate = self._core.gate
        for block, verdict in gate.admitted(blocks, self._room):
            if not self._described and block.source:
                self._valve_id = self._diagnostics.valve_id = block.source
            events = self._core.update(block, verdict)
            if gate.fault is Fault.NEW_SOURCE:
                self.get_logger().info(f"acceleration: {Fault.NEW_SOURCE.value}")
            if verdict is not Verdict.REFUSED:
                self._no_blocks.end()
                if self._trends is not None:
                    self._trends.update(block)
                    self._trends.update_strokes(self._core.strokes.strokes)
            if gate.before is None:
                self._no_estimates.end()
            self._publish(events)

    def _take_number(self, take: Callable[[int, float], object], message: Float64) -> None:
        """Take a number that has no stamp: it holds at the end of the newest block."""
        last = self._core.gate.last
        if last is not None:
            take(last.end, message.data)

    def _take_temperature(self, message: Temperature) -> None:
        self._publish(self._core.update_temperature(nanoseconds(message.header.stamp), message.temperature))

    def _take_estimate(self, message: ModelEstimate) -> None:
        estimate = from_message(message)
        events = self._core.update_estimate(estimate)
        standing, used = self._core.estimates.standing, self._core.estimate is estimate
        if standing is not Standing.SECOND:
            self._no_estimates.end()
        if standing is Standing.RESTARTED:
            self.get_logger().info("estimate: the estimator was restarted, or another estimator replaced it")
        described = self._descriptions.follow(self._core.estimates) if used else None
        if described is not None:
            self._describe(described)
        self._publish(events)
        if not used:
            return
        self._alarms.take_estimate(estimate)
        if self._trends is not None:
            self._trends.update_estimate(estimate)

    def _watch(self) -> None:
        self._no_blocks.look()
        self._no_estimates.look()
        if self.host.hub.waits(self, "acceleration"):
            self._no_blocks.end()
        nobody = ""
        if self._core.gate.accepted == 0 and self.count_publishers("acceleration") == 0:
            nobody = self.resolve_topic_name("acceleration")
            self._no_blocks.end()
        if self._core.estimate is None and not self._described and self._estimator_starts():
            self._no_estimates.end()
        stamp = self.get_clock().now().nanoseconds
        self._publish(self._core.idle(self._no_blocks.seconds, self._no_estimates.seconds, stamp, nobody))
        self._alarms.watch()

    def _estimator_starts(self) -> bool:
        """Whether the estimator of this valve may still be starting: it compiles or is unconfigured."""
        if time.monotonic() - self._activated > STARTS:
            return False
        return ("estimator", self.get_namespace()) in self.get_node_names_and_namespaces()

    def _publish(self, events: list[Event]) -> None:
        if events:
            self._alarms.take(events)
        for event in events:
            self._event_publisher.publish(to_event_message(event, self._valve_id, self._language))
        if events or self._core.level is not self._level:
            self._report()

    def _health(self) -> Health:
        """Return the present judgement, at the node's time before the first block."""
        health = self._core.health
        return health if health.stamp else replace(health, stamp=self.get_clock().now().nanoseconds)

    def _report(self) -> None:
        health = self._health()
        self._level = health.level
        health = replace(health, namur=max(health.namur, self._alarms.namur))
        self._health_publisher.publish(to_health_message(health, self._valve_id))
        detection, aside = self._core.detection, self._alarms.silence_put_aside
        tasks = [data_status(detection, self._core.gate, health), condition_status(self._core, health)]
        if aside:
            text = f"{health.summary}: {aside}"
            tasks = [
                replace(task, level=Level.OK, message=text) if task.level is Level.STALE else task
                for task in tasks
            ]
        self._diagnostics.publish(
            *tasks, self._alarms.status(health.namur, self._trends), *self._alarms.statuses()
        )


def to_health_message(health: Health, valve_id: str) -> ValveHealth:
    """Return ``health`` of the valve ``valve_id`` as a message."""
    message = ValveHealth(
        level=int(health.level),
        baseline=int(health.baseline),
        summary=health.summary,
        active=list(health.active),
        judgements=[f"{name}: {JUDGEMENT_TEXTS[judgement]}" for name, judgement in health.judgements],
        namur=int(health.namur),
        **{name: to_quantity(getattr(health, name)) for name in _QUANTITIES},
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(health.stamp)
    return message


def to_alarm_message(alarm: Alarm, valve_id: str, language: Language) -> AlarmMessage:
    """Return ``alarm`` of the valve ``valve_id`` as a message with its headline in ``language``."""
    message = AlarmMessage(
        namur=int(alarm.namur),
        state=int(alarm.state),
        underlying=int(alarm.underlying),
        severity=int(alarm.severity),
        **{name: getattr(alarm, name) for name in _ALARM_FIELDS},
        raised_at=to_time(alarm.raised_at),
        acknowledged_at=to_time(alarm.acknowledged_at),
        shelved_until=to_time(alarm.hidden_until),
    )
    if alarm.hidden_by is not None:
        message.hidden_by, message.hidden_comment = alarm.hidden_by.who, alarm.hidden_by.comment
        message.hidden_at = to_time(alarm.hidden_by.stamp)
    message.value = math.nan
    if alarm.event is not None:
        message.event = to_event_message(alarm.event, valve_id, language)
        message.message = message.event.message
        message.value, message.unit = alarm.event.quantity.value, alarm.event.quantity.unit
    message.header.frame_id = valve_id
    message.header.stamp = to_time(alarm.changed_at)
    return message


def to_alarm_list(alarms: Iterable[Alarm], stamp: int, valve_id: str, language: Language) -> AlarmList:
    """Return ``alarms`` in their order, published at ``stamp`` (ns)."""
    message = AlarmList(alarms=[to_alarm_message(alarm, valve_id, language) for alarm in alarms])
    message.header.frame_id = valve_id
    message.header.stamp = to_time(stamp)
    return message


def data_status(detection: Detection, gate: BlockGate, health: Health) -> Status:
    """Return what arrives, and whether the sensors can be believed."""
    sensors = _detector_status("data", detection, health, ())
    level, text = sensors.level, sensors.message
    faults = block_faults(gate)
    if health.level is HealthLevel.STALE:
        text = health.summary
    elif gate.accepted == 0:
        level, text = Level.WARNING, health.summary
    elif level is Level.OK:
        level, text = (Level.WARNING, faults) if faults else (level, "no block lost or refused lately")
    return Status("data", level, text, {**block_values(gate), **sensors.values})


def condition_status(monitor: Monitor, health: Health) -> Status:
    """Return what is wrong with the valve, how it moves and is switched, and where no drift is reported."""
    detection, strokes = monitor.detection, monitor.strokes
    shown = (getattr(health, name) for name in _QUANTITIES)
    status = _detector_status("condition", detection, health, shown)
    warns = {
        key(f"{name}_{end}", detection.units[name]): value
        for name, drift in detection.parameters.items()
        for end, value in zip(ENDS, drift.bounds, strict=True)
    }
    switched = {
        key(f"{one.name}{end}", "s"): value for one in detection.detectors for end, value in one.shown.items()
    }
    if strokes.count:
        switched |= {"strokes_today": strokes.count, "judged_share": strokes.share}
    return replace(status, values={**status.values, **warns, **switched})


def alarm_status(alarm: Alarm, namespace: str) -> Status:
    """Return what ``/diagnostics`` shows of ``alarm``: not OK while it stands and is not put aside.

    ``fault_code`` is for fault memories that know a fault by its code alone, as ros2_medkit's does: it is the
    same whatever the cause, and no other alarm of any valve has it.
    """
    level = Level.OK
    if not alarm.hidden and (alarm.active or alarm.latched):
        severe = alarm.active and alarm.severity is Severity.ALARM
        level = Level.ERROR if severe else Level.WARNING
    told = _words(alarm.state)
    if alarm.event is not None and level is not Level.OK:
        told = headline(alarm.event)
    values = {
        "code": alarm.code,
        "fault_code": _FAULT_CODE.sub(".", f"{namespace}/{alarm.name}").strip(".")[-LONGEST_FAULT_CODE:],
        "ne_107": alarm.kind_namur.letter,
        "state": _words(alarm.state),
        "occurrence": alarm.occurrence,
    }
    return Status(f"alarm {alarm.name}", level, told, values)


class AlarmServices:
    """Alarm services of one monitor: what operators do, the latched topic ``alarms``, and what is kept.

    A change is on the disk before it is published or answered.
    """

    def __init__(self, node: ManagedNode, state: ValveState, language: Language) -> None:
        self._node = node
        self._language = language
        self._state = state
        self.valve_id = node.get_namespace().strip("/")
        self._publisher = node.create_lifecycle_publisher(AlarmList, "alarms", qos.state())
        for kind, name in (
            (AcknowledgeAlarm, "acknowledge_alarm"),
            (ShelveAlarm, "shelve_alarm"),
            (SuppressAlarm, "suppress_alarm"),
            (ResetAlarms, "reset_alarms"),
        ):
            node.serve(kind, f"~/{name}", partial(self._answer, kind))
        node.serve(ManageBaseline, "~/manage_baseline", self._baseline)

    def close(self) -> None:
        """Take the publisher away."""
        self._node.destroy_publisher(self._publisher)
        self._state.close()

    def identify(self, valve_id: str, oil: str) -> None:
        """Set the valve and load its kept baseline."""
        self.valve_id = valve_id
        try:
            if self._state.baseline.identify(valve_id, oil):
                current = self._state.baseline.current
                assert current is not None
                self._node.get_logger().info(
                    f"comparing with baseline version {current.version} ({current.stage.value})"
                )
        except InputError as error:
            self._node.get_logger().warning(f"{error}; learning")

    def take(self, events: Sequence[Event]) -> None:
        """Take the monitor's events; each is logged once."""
        transitions = [self._state.alarms.update(event) for event in events]
        self._settle(transitions)
        for event, transition in zip(events, transitions, strict=True):
            if not transition.changed or Action.ANNOUNCE not in transition.actions:
                self._node.get_logger().info(
                    f"{transition.after.name} {event.state.name.lower()}: {headline(event, self._language)}"
                )

    def take_estimate(self, estimate: Estimate) -> None:
        """Take an estimate that the monitor has seen."""
        before = self._state.baseline.current
        if not self._state.baseline.update(estimate):
            return
        with waiting_for_disk():
            self._state.keep_baseline()
        current = self._state.baseline.current
        assert current is not None
        if before is None:  # what takes longer to learn joins the same version later
            self._node.get_logger().info(f"baseline version {current.version} of {current.valve_id} learned")

    @property
    def namur(self) -> Namur:
        """Status after NE 107 as far as maintenance makes it."""
        serviced = any(alarm.out_of_service for alarm in self._state.alarms.alarms.values())
        return Namur.FUNCTION_CHECK if serviced else Namur.UNKNOWN

    @property
    def silence_put_aside(self) -> str:
        """How an operator or the plant's logic put the silence of the valve aside; empty: not at all."""
        silent = [one for one in self._state.alarms.alarms.values() if one.kind == STALE.name and one.active]
        if not silent or not all(one.hidden for one in silent):
            return ""
        return _words(silent[0].state)

    def statuses(self) -> list[Status]:
        """Return a task for each alarm that stands, or ever stood; they alone have a ``code``.

        A fault memory keeps one fault for each task, which ends with level OK, and an aggregator shows a task
        that stops as STALE: alarms that are over are sent on, also after a restart.
        """
        alarms, namespace = self._state.alarms.alarms, self._node.get_namespace()
        return [alarm_status(one, namespace) for _, one in sorted(alarms.items()) if one.changed_at]

    def status(self, namur: Namur, trends: TrendWriter | None) -> Status:
        """Return what ``/diagnostics`` shows of the alarms: what is put aside does not raise its level."""
        alarms = self._state.alarms.alarms.values()
        shown = [alarm for alarm in self._state.alarms.shown if not alarm.hidden]
        waiting = [alarm for alarm in shown if not alarm.acknowledged]
        states = [alarm.state for alarm in alarms]
        level = Level.WARNING if shown else Level.OK
        if any(alarm.active and alarm.severity is Severity.ALARM for alarm in shown):
            level = Level.ERROR
        names = ", ".join(alarm.name for alarm in waiting or shown)
        text = f"waiting for an operator: {names}" if waiting else names or "none"
        current = self._state.baseline.current
        values: dict[str, object] = {
            "ne_107": f"{namur.letter} {namur.name.lower().replace('_', ' ')}".strip(),
            "active": sum(alarm.active for alarm in shown),
            "waiting": len(waiting),
            "latched": sum(alarm.latched for alarm in shown),
            "shelved": states.count(AlarmState.SHELVED),
            "suppressed": states.count(AlarmState.SUPPRESSED),
            "out_of_service": states.count(AlarmState.OUT_OF_SERVICE),
            "baseline": f"version {current.version} {current.stage.value}" if current else "learning",
            "kept_over_a_restart": "yes" if self._state.writable else "no",
        }
        trouble = trends.trouble if trends is not None else ""
        held = f"held in memory: {trouble}" if trouble else "kept"
        values["trends"] = "none" if trends is None else held
        values["travel_m"] = math.nan if trends is None else trends.travel.travel
        values["reversals"] = math.nan if trends is None else trends.travel.reversals
        return Status("alarms", level, text, values)

    def watch(self) -> None:
        """End the shelves and times out of service that are due; write what could not be written."""
        ended = self._state.alarms.advance(self._now())
        self._settle(ended)
        for one in ended:
            self._node.get_logger().info(f"{one.after.name}: {one.input.value}, its time is over")
        if self._state.retry(self._now()):
            self.show()

    def _settle(self, transitions: Sequence[Transition], operator: Operator | None = None) -> None:
        if not any(transition.changed for transition in transitions):
            return
        with waiting_for_disk():
            self._state.note(entries_of(transitions, operator))
            self._state.keep_alarms()
        self.show()
        for transition in transitions:
            if Action.ANNOUNCE in transition.actions:
                alarm = transition.after
                said = headline(alarm.event, self._language) if alarm.event is not None else ""
                text = f"{alarm.severity.name.lower()} {alarm.code} {alarm.name}: {said}"
                # The valve or its measurement has failed (NE 107: F), or less than that. A line each: rclpy
                # lets a line of code log in one severity only.
                if alarm.namur is Namur.FAILURE:
                    self._node.get_logger().error(text)
                else:
                    self._node.get_logger().warning(text)

    def show(self) -> None:
        """Publish what there is."""
        alarms = self._state.alarms
        shown = alarms.shown
        names = {alarm.name for alarm in shown}
        rest = [alarm for name, alarm in alarms.alarms.items() if name not in names]
        self._publisher.publish(to_alarm_list([*shown, *rest], self._now(), self.valve_id, self._language))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    # Services.

    def _operator(self, request: Any) -> Operator:
        return Operator(request.who, self._now(), request.comment)

    def _answer(self, kind: Any, request: Any, response: Any) -> Any:
        operator = self._operator(request)
        transitions = self._act(kind, request, operator)
        self._settle(transitions, operator)
        response.success = True
        response.changed = [transition.after.name for transition in transitions]
        done = f"{transitions[0].input.value}: {', '.join(response.changed)}, by {operator.who}"
        self._node.get_logger().info(done)
        return response

    def _act(self, kind: Any, request: Any, operator: Operator) -> Sequence[Transition]:
        alarms = self._state.alarms
        if kind is AcknowledgeAlarm:
            return alarms.acknowledge(request.alarm, operator, request.occurrence)
        if kind is ResetAlarms:
            return alarms.operate(request.alarm, acts.reset, operator)
        if kind is ShelveAlarm:
            if request.shelved:
                return alarms.operate(request.alarm, acts.shelve, operator, request.duration)
            return alarms.operate(request.alarm, acts.unshelve, operator)
        on, seconds = request.suppressed, request.duration
        if request.way == SuppressAlarm.Request.OUT_OF_SERVICE:
            return alarms.operate(request.alarm, acts.maintain, operator, on=on, seconds=seconds)
        if request.way != SuppressAlarm.Request.BY_DESIGN:
            raise AlarmRefusedError(f"way: {request.way} is not 0 (by design) or 1 (out of service)")
        if seconds:
            raise AlarmRefusedError("duration: only a time out of service has an end; shelve the alarm")
        return alarms.operate(request.alarm, acts.suppress, operator, on=on)

    def _baseline(self, request: Any, response: Any) -> Any:
        keeper = self._state.baseline
        version = request.version
        actions: dict[int, tuple[Callable[[Operator], object], str]] = {
            request.LEARN: (lambda _: keeper.learn(), "learning again"),
            request.FREEZE: (keeper.freeze, "frozen"),
            request.RESTORE: (lambda _: keeper.restore(version), f"version {version} restored"),
        }
        if request.action in actions:
            operator, (change, done) = self._operator(request), actions[request.action]
            change(operator)
            self._state.keep_baseline()
            act = JournalEntry(
                operator.stamp, "baseline", who=operator.who, comment=operator.comment, text=done
            )
            self._state.note([act])
            comment = f" ({request.comment.strip()})" if request.comment.strip() else ""
            self._node.get_logger().info(f"baseline changed by {operator.who}: {done}{comment}")
        elif request.action != request.SHOW:
            raise AlarmRefusedError(f"action: {request.action} is not one of 0 to {request.RESTORE}")
        response.success = True
        response.stage = "learning"
        current = keeper.current
        if current is not None:
            response.version, response.stage = current.version, current.stage.value
            response.valve_id, response.oil = current.valve_id, current.oil
            response.temperature = list(current.temperature)
            response.frozen_by = current.who
            response.counts = [value.count for value in current.values]
            response.values = [
                to_quantity(
                    Quantity(value.name, value.unit, value.value, value.standard_deviation, Validity.VALID)
                )
                for value in current.values
            ]
        return response


def _words(state: AlarmState) -> str:
    return state.name.lower().replace("_", " ")


def _detector_status(task: str, detection: Detection, health: Health, shown: Iterable[Quantity]) -> Status:
    """Return what the detectors of ``task`` report, also what they can't judge."""
    ours = [one for one in detection.detectors if one.kind.task == task]
    names = {one.name for one in ours}
    conditions = [condition for one in ours for condition in detection.conditions_of(one)]
    active = [condition for condition in conditions if condition.active is not None]
    worst = max((condition.active for condition in active if condition.active is not None), default=None)
    level = _LEVELS[worst]
    text = ", ".join(one.title for one in active)
    if not text:
        open_ = {one.judgement for one in ours if one.judgement is not Judgement.JUDGED}
        text = ", ".join(JUDGEMENT_TEXTS[judgement] for judgement in sorted(open_)) or "nothing found"
    if health.level is HealthLevel.UNKNOWN and not active:
        level = Level.WARNING
    if health.level is HealthLevel.STALE:
        level, text = Level.STALE, "no data"
    return Status(
        task,
        level,
        text,
        {
            **{key(value.name, value.unit): value.value for value in shown},
            **{
                f"{name.rpartition('/')[2]}_judgement": JUDGEMENT_TEXTS[judgement]
                for name, judgement in detection.judgements.items()
                if name.partition("/")[0] in names
            },
        },
    )
