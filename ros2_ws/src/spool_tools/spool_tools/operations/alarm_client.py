"""Client of a monitor's alarms: its topic and services, for an operator at a terminal."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Any

from builtin_interfaces.msg import Time
from spool_core.errors import InputError
from spool_core.node import qos
from spool_monitor.alarms.alarm import AlarmState
from spool_msgs.msg import AlarmList
from spool_msgs.srv import AcknowledgeAlarm, ResetAlarms, ShelveAlarm, SuppressAlarm

from .service_client import call, client_node, until, who_asks

SERVICES: dict[str, Any] = {
    "acknowledge_alarm": AcknowledgeAlarm,
    "shelve_alarm": ShelveAlarm,
    "suppress_alarm": SuppressAlarm,
    "reset_alarms": ResetAlarms,
}
_WAITING = (
    AlarmState.UNACKNOWLEDGED,
    AlarmState.RETURNED_UNACKNOWLEDGED,
    AlarmState.LATCHED_UNACKNOWLEDGED,
)


def show_alarms(valve: str, *, every: bool) -> int:
    """Print the alarms of ``valve``; return 1 where one waits for an operator."""
    with client_node("spool_alarm", valve) as node:
        heard: list[AlarmList] = []
        node.create_subscription(AlarmList, f"/{valve}/alarms", heard.append, qos.state())
        until(node, lambda: bool(heard), f"{valve}/monitor")
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
    request = kind.Request(who=who_asks(who), **fields)
    with client_node("spool_alarm", valve) as node:
        answer = call(node, f"{valve}/monitor", service, request, kind)
    if not answer.success:
        raise InputError(f"{valve}: {answer.reason}")
    print(f"{valve}: {', '.join(answer.changed)}")
