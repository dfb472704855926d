"""Client of a monitor's alarms: its topic and services, for an operator at a terminal."""

from __future__ import annotations

import getpass
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from spool_bag.names import check_valve
from spool_monitor.alarms.alarm import AlarmState
from spool_msgs.msg import AlarmList
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm, SuppressAlarm
from spool_node import qos
from spool_stream.errors import InputError

SERVICES: dict[str, Any] = {
    "acknowledge_alarm": AcknowledgeAlarm,
    "shelve_alarm": ShelveAlarm,
    "suppress_alarm": SuppressAlarm,
    "reset_alarms": ResetAlarms,
}
#: s that a running monitor may take to be found and to answer.
PATIENCE = 5.0

_WAITING = (
    AlarmState.UNACKNOWLEDGED,
    AlarmState.RETURNED_UNACKNOWLEDGED,
    AlarmState.LATCHED_UNACKNOWLEDGED,
)


def show_alarms(valve: str, *, every: bool) -> int:
    """Print the alarms of ``valve``; return 1 where one waits for an operator."""
    with _node(valve) as node:
        heard: list[AlarmList] = []
        node.create_subscription(AlarmList, f"/{valve}/alarms", heard.append, qos.state())
        _until(node, lambda: bool(heard), valve)
    listed = [one for one in heard[-1].alarms if every or one.state != AlarmState.NORMAL]
    if not listed:
        print(f"{valve}: no alarms")
        return 0
    for one in listed:
        words = [f"{one.code:4}  {one.name}", AlarmState(one.state).name.lower().replace("_", " ")]
        words += [f"cause {one.cause.replace('_', ' ')}"] if one.cause else []
        words += [f"raised {_clock(one.raised_at)}"] if one.raised_at.sec else []
        words += [f"acknowledged by {one.acknowledged_by}"] if one.acknowledged_by else []
        print(", ".join(words))
        if one.message:
            print(f"      {one.message}")
    return 1 if any(one.state in _WAITING for one in listed) else 0


def _who(given: str) -> str:
    """Return the name given, else the one that the user is logged in by."""
    try:
        return given or getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError("--who: say who does this") from error


def _clock(at: Time) -> str:
    return datetime.fromtimestamp(at.sec, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")


def ask(valve: str, service: str, *, who: str, **fields: object) -> None:
    """Call a service of the valve's monitor and say what changed.

    Args:
        valve: namespace.
        service: one of ``SERVICES``.
        who: does it; empty: the one that the user is logged in by.
        fields: of the request.

    Raises:
        InputError: no monitor answers, or it refuses; its reason is given.
    """
    kind = SERVICES[service]
    request = kind.Request(who=_who(who), **fields)
    with _node(valve) as node:
        client = node.create_client(kind, f"/{valve}/monitor/{service}")
        _meet(node, valve)
        _until(node, client.service_is_ready, valve)
        future = client.call_async(request)
        _until(node, future.done, valve)
        answer = future.result()
    if not answer.success:
        raise InputError(f"{valve}: {answer.reason}")
    print(f"{valve}: {', '.join(answer.changed)}")


def _meet(node: Node, valve: str) -> None:
    """Ask for its state until the monitor answers: it drops answers to clients that it does not know yet.

    Clients become known in the order they were made, so it knows all earlier ones then.
    """
    client = node.create_client(GetState, f"/{valve}/monitor/get_state")
    futures: list[Any] = []
    due = 0.0

    def answered() -> bool:
        nonlocal due
        if time.monotonic() >= due and client.service_is_ready():
            futures.append(client.call_async(GetState.Request()))
            due = time.monotonic() + 1.0
        return any(future.done() for future in futures)

    _until(node, answered, valve)


def _until(node: Node, met: Callable[[], object], valve: str) -> None:
    end = time.monotonic() + PATIENCE
    while not met():
        if time.monotonic() > end:
            raise InputError(
                f"{valve}: no active monitor answers in /{valve}: is it running, with the same ROS_DOMAIN_ID?"
            )
        rclpy.spin_once(node, timeout_sec=0.05)


@contextmanager
def _node(valve: str) -> Iterator[Node]:
    check_valve(valve)
    rclpy.init()
    node = Node("spool_alarm")
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown()
