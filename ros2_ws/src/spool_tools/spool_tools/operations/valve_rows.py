"""Running valves as they are heard: what their monitors publish, and what an operator asks of them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rich.text import Text
from spool_core.events.language import Language
from spool_core.events.sentences import details, headline
from spool_core.node import qos
from spool_core.node.messages import from_event_message
from spool_core.node.service_calls import ServiceCalls
from spool_core.uncertainty import with_interval
from spool_monitor import listener as conditions
from spool_monitor.listener import monitored_valves
from spool_msgs.msg import Alarm, AlarmList, HealthEvent, ModelEstimate, Quantity, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm, SuppressAlarm

#: s between looks for valves that joined and between steps of calls; valves and events held at most.
LOOK_EVERY, CALL_EVERY, MOST_VALVES, EVENTS = 1.0, 0.1, 1000, 200
#: Services of a monitor by which operators act on alarms.
SERVICES: dict[str, Any] = {
    "acknowledge_alarm": AcknowledgeAlarm,
    "shelve_alarm": ShelveAlarm,
    "suppress_alarm": SuppressAlarm,
    "reset_alarms": ResetAlarms,
}

SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "ALARM"}

_LOOKS = {
    conditions.ALARM: ("ALARM", "\u25b2", "bold red"),
    conditions.NO_WORD: ("NO WORD", "\u00d7", "bold magenta"),
    conditions.STALE: ("STALE", "\u00d7", "bold magenta"),
    conditions.WARNING: ("WARNING", "\u25c6", "bold yellow"),
    conditions.UNKNOWN: ("UNKNOWN", "?", "bold"),
    conditions.LEARNING: ("LEARNING", "\u2026", "cyan"),
    conditions.AT_REST: ("AT REST", "\u2013", "cyan"),
    conditions.GOOD: ("OK", "\u25cf", "bold green"),
}


@dataclass(frozen=True, slots=True)
class Shown:
    """Condition as it is shown; lower ``rank`` is worse."""

    word: str
    mark: str
    style: str
    rank: int


SHOWN = {name: Shown(*_LOOKS[name], rank) for rank, name in enumerate(conditions.CONDITIONS)}

VALVE_COLUMNS = ("valve", "health", "shakes at", "natural", "stiffness", "viscous", "Coulomb", "says")
ALARM_COLUMNS = ("alarm", "state", "severity", "since", "by", "says")
#: States in which an alarm waits for an operator.
WAITING = (
    Alarm.STATE_UNACKNOWLEDGED,
    Alarm.STATE_RETURNED_UNACKNOWLEDGED,
    Alarm.STATE_LATCHED_UNACKNOWLEDGED,
)


@dataclass(slots=True)
class HeardValve:
    """Last messages of a valve and when they arrived (s, monotonic)."""

    name: str
    health: ValveHealth | None = None
    health_at: float = 0.0
    estimate: ModelEstimate | None = None
    alarms: AlarmList | None = None


class Listener:
    """Listener to all valves of this ROS domain, or to those named; works in a thread of its own."""

    def __init__(self, names: tuple[str, ...] = ()) -> None:
        """Begin to listen; without ``names`` to every valve whose monitor is heard."""
        self.valves: dict[str, HeardValve] = {}
        self.events: deque[tuple[str, HealthEvent]] = deque(maxlen=EVENTS)
        self._names = names
        rclpy.init()
        self._node = Node("spool_watch")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._calls = ServiceCalls(self._node)
        self._started = self._node.get_clock().now().nanoseconds
        for name in names:
            self._join(name)
        self._node.create_timer(LOOK_EVERY, self._look)
        self._node.create_timer(CALL_EVERY, self._calls.work)
        self._look()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def acknowledge(self, valve: str, alarm: str, occurrence: int, who: str, comment: str) -> Future[str]:
        """Ask the monitor of ``valve`` to note that ``who`` has seen ``alarm``, as often as it was shown."""
        request = AcknowledgeAlarm.Request(alarm=alarm, who=who, comment=comment, occurrence=occurrence)
        return self._ask(valve, "acknowledge_alarm", request)

    def shelve(
        self, valve: str, alarm: str, seconds: float, who: str, comment: str, *, shelved: bool
    ) -> Future[str]:
        """Ask the monitor of ``valve`` to put ``alarm`` aside for ``seconds``, or to take that back."""
        request = ShelveAlarm.Request(
            alarm=alarm, who=who, comment=comment, shelved=shelved, duration=seconds
        )
        return self._ask(valve, "shelve_alarm", request)

    def reset(self, valve: str, alarm: str, who: str, comment: str) -> Future[str]:
        """Ask the monitor of ``valve`` to reset the latched ``alarm``."""
        request = ResetAlarms.Request(alarm=alarm, who=who, comment=comment)
        return self._ask(valve, "reset_alarms", request)

    def _ask(self, valve: str, service: str, request: Any) -> Future[str]:
        """Return what is to be said to the operator, once it is known."""
        said: Future[str] = Future()

        def take(answer: Future[Any]) -> None:
            got = answer.result()
            if got is None:
                said.set_result(f"{valve}: its monitor does not answer")
            else:
                changed = ", ".join(got.changed) if got.success else got.reason
                said.set_result(f"{valve}: {service.replace('_', ' ')}: {changed}")

        answer = self._calls.ask(f"/{valve}/monitor", service, request, SERVICES[service])
        answer.add_done_callback(take)
        return said

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _look(self) -> None:
        if self._names:
            return
        for name in monitored_valves(self._node):
            if len(self.valves) < MOST_VALVES:
                self._join(name)

    def _join(self, name: str) -> None:
        if name in self.valves:
            return
        valve = self.valves[name] = HeardValve(name)
        for kind, topic, take in (
            (ValveHealth, "health", partial(self._on_health, valve)),
            (ModelEstimate, "estimate", partial(setattr, valve, "estimate")),
            (AlarmList, "alarms", partial(setattr, valve, "alarms")),
        ):
            self._node.create_subscription(kind, f"/{name}/{topic}", take, qos.state())
        self._node.create_subscription(
            HealthEvent, f"/{name}/events", partial(self._on_event, name), qos.state(100)
        )

    @staticmethod
    def _on_health(valve: HeardValve, message: ValveHealth) -> None:
        valve.health, valve.health_at = message, time.monotonic()

    def _on_event(self, name: str, message: HealthEvent) -> None:
        self.events.append((name, message))


def shown_condition(valve: HeardValve, now: float) -> Shown:
    """Return the condition of ``valve`` at ``now`` (s, monotonic)."""
    return SHOWN[conditions.condition_of(valve.health, now - valve.health_at)]


def valve_row(valve: HeardValve, now: float) -> tuple[Text, ...]:
    """Return the cells of ``VALVE_COLUMNS`` for ``valve`` at ``now`` (s, monotonic)."""
    condition = shown_condition(valve, now)
    state = Text(f"{condition.mark} {condition.word}", style=condition.style)
    health = valve.health
    shakes = None if health is None else health.dominant_frequency
    cells = (
        f"{shakes.value:.1f} Hz" if shakes and shakes.validity == Quantity.VALIDITY_VALID else "no line",
        *estimate_cells(valve.estimate),
        "" if health is None else health.summary,
    )
    return (Text(valve.name), state, *(Text(cell) for cell in cells))


def estimate_cells(estimate: ModelEstimate | None, unknown: str = "not known") -> Iterator[str]:
    """Yield natural frequency, stiffness, viscous coefficient and Coulomb force with their intervals."""
    values = {} if estimate is None else {one.name: one for one in estimate.parameters}
    names = ("spring_stiffness", "viscous_coefficient", "coulomb_force")
    natural = None if estimate is None else estimate.natural_frequency
    for one in (natural, *map(values.get, names)):
        if one is None or one.validity == Quantity.VALIDITY_UNKNOWN:
            yield unknown
            continue
        held = " held" if one.validity == Quantity.VALIDITY_HELD else ""
        unit = one.unit.replace(" s", "\u00b7s")
        yield f"{with_interval(one.value, one.standard_deviation, unit)}{held}"


def alarm_row(alarm: Alarm, language: Language) -> tuple[Text, ...]:
    """Return the cells of ``ALARM_COLUMNS`` for ``alarm``."""
    from spool_monitor.alarm import AlarmState  # noqa: PLC0415 - SciPy, which off a terminal nobody needs

    state = AlarmState(alarm.state)
    waits = state in WAITING
    raised = datetime.fromtimestamp(alarm.raised_at.sec).strftime("%d %b %H:%M:%S")
    return (
        Text(f"{alarm.code} {alarm.name.replace('_', ' ')}"),
        Text(state.name.lower().replace("_", " "), style="bold red" if waits else ""),
        Text(SEVERITIES.get(alarm.severity, "")),
        Text(raised if alarm.raised_at.sec else ""),
        Text(alarm.acknowledged_by),
        Text(alarm_headline(alarm, language)),
    )


def alarm_headline(alarm: Alarm, language: Language) -> str:
    """Return the headline of the alarm's last event; empty before the first."""
    return headline(from_event_message(alarm.event), language) if alarm.message else ""


def alarm_details(alarm: Alarm, language: Language) -> list[str]:
    """Return the details of the alarm's last event, a line each."""
    return [str(one) for one in details(from_event_message(alarm.event), language)] if alarm.message else []


def event_line(event: HealthEvent, language: Language) -> str:
    """Return an event as one line: its severity where it was raised, and its headline."""
    raised = event.state == HealthEvent.STATE_RAISED
    said = headline(from_event_message(event), language)
    return f"{SEVERITIES.get(event.severity, 'event')}: {said}" if raised else said


def shown_alarms(valve: HeardValve | None) -> list[Alarm]:
    """Return the alarms of ``valve`` that are not normal, those that wait first."""
    listed = [] if valve is None or valve.alarms is None else list(valve.alarms.alarms)
    return [one for one in listed if one.state not in (Alarm.STATE_NORMAL, Alarm.STATE_UNKNOWN)]


def line_of(valve: HeardValve, now: float) -> str:
    """Return the row of ``valve`` as a line, for where there is no terminal."""
    return "  ".join(cell.plain for cell in valve_row(valve, now))
