"""Heard valves: the last messages of each running valve, bounded whatever the run time."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from spool_core.node import qos
from spool_monitor.node.valve_condition import monitored_valves
from spool_msgs.msg import AlarmList, HealthEvent, ModelEstimate, ValveHealth
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm

#: s between looks for valves that joined; valves and events that are held at most.
LOOK_EVERY, MOST_VALVES, EVENTS = 1.0, 1000, 200
#: s that a monitor may take to answer.
PATIENCE = 5.0
SERVICES: dict[str, Any] = {
    "acknowledge_alarm": AcknowledgeAlarm,
    "shelve_alarm": ShelveAlarm,
    "reset_alarms": ResetAlarms,
}


@dataclass(slots=True)
class HeardValve:
    """Last messages of a valve and when they arrived (s, monotonic)."""

    name: str
    health: ValveHealth | None = None
    health_at: float = 0.0
    estimate: ModelEstimate | None = None
    alarms: AlarmList | None = None


@dataclass(slots=True)
class Answer:
    """Answer to an operator's request to ``valve``: ``text`` for people, ``None`` while it is awaited."""

    valve: str
    text: str | None = None
    asked: float = field(default_factory=time.monotonic)

    def said(self) -> str | None:
        """Return what is to be said by now, ``None`` while it is awaited."""
        if self.text is None and time.monotonic() - self.asked > PATIENCE:
            self.text = f"{self.valve}: its monitor does not answer"
        return self.text


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
        self._clients: dict[tuple[str, str], Any] = {}
        self._started = self._node.get_clock().now().nanoseconds
        for name in names:
            self._join(name)
        self._node.create_timer(LOOK_EVERY, self._look)
        self._look()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._executor.shutdown()
        self._thread.join(timeout=2.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    def acknowledge(self, valve: str, alarm: str, occurrence: int, who: str, comment: str) -> Answer:
        """Ask the monitor of ``valve`` to note that ``who`` has seen ``alarm``, as often as it was shown."""
        request = AcknowledgeAlarm.Request(alarm=alarm, who=who, comment=comment, occurrence=occurrence)
        return self._ask(valve, "acknowledge_alarm", request)

    def shelve(
        self, valve: str, alarm: str, seconds: float, who: str, comment: str, *, shelved: bool
    ) -> Answer:
        """Ask the monitor of ``valve`` to put ``alarm`` aside for ``seconds``, or to take that back."""
        request = ShelveAlarm.Request(
            alarm=alarm, who=who, comment=comment, shelved=shelved, duration=seconds
        )
        return self._ask(valve, "shelve_alarm", request)

    def reset(self, valve: str, alarm: str, who: str, comment: str) -> Answer:
        """Ask the monitor of ``valve`` to let go of the latched ``alarm``."""
        request = ResetAlarms.Request(alarm=alarm, who=who, comment=comment)
        return self._ask(valve, "reset_alarms", request)

    def _ask(self, valve: str, service: str, request: Any) -> Answer:
        answer = Answer(valve)

        def take(future: Any) -> None:
            got = future.result()
            changed = ", ".join(got.changed) if got.success else got.reason
            answer.text = f"{valve}: {service.replace('_', ' ')}: {changed}"

        self._clients[valve, service].call_async(request).add_done_callback(take)
        return answer

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
            (ValveHealth, "health", self._on_health),
            (ModelEstimate, "estimate", self._on_estimate),
            (AlarmList, "alarms", self._on_alarms),
        ):
            self._node.create_subscription(kind, f"/{name}/{topic}", partial(take, valve), qos.state())
        # A server drops answers to clients that it does not know yet: these are known long before they ask.
        for service, service_type in SERVICES.items():
            server = f"/{name}/monitor/{service}"
            self._clients[name, service] = self._node.create_client(service_type, server)
        self._node.create_subscription(
            HealthEvent, f"/{name}/events", partial(self._on_event, name), qos.state(100)
        )

    @staticmethod
    def _on_health(valve: HeardValve, message: ValveHealth) -> None:
        valve.health, valve.health_at = message, time.monotonic()

    @staticmethod
    def _on_estimate(valve: HeardValve, message: ModelEstimate) -> None:
        valve.estimate = message

    @staticmethod
    def _on_alarms(valve: HeardValve, message: AlarmList) -> None:
        valve.alarms = message

    def _on_event(self, name: str, message: HealthEvent) -> None:
        self.events.append((name, message))
