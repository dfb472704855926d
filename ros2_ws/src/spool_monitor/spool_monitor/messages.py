"""Messages of health, events and alarms."""

from __future__ import annotations

from collections.abc import Iterable

from spool_core.node.messages import to_quantity, to_time
from spool_msgs.msg import Alarm as AlarmMessage
from spool_msgs.msg import AlarmList, HealthEvent, ValveHealth

from spool_monitor.alarm import Alarm
from spool_monitor.detectors import JUDGEMENT_TEXTS, event_kind
from spool_monitor.event import Event
from spool_monitor.monitor import Health

_QUANTITIES = ("dominant_frequency", "amplification", "natural_frequency", "viscous_drift", "coulomb_drift")

_ALARM_FIELDS = (
    "name", "kind", "cause", "code", "occurrence", "value", "unit", "message", "acknowledged_by", "comment",
)  # fmt: skip


def to_event_message(event: Event, valve_id: str) -> HealthEvent:
    """Return ``event`` of the valve ``valve_id`` as a message."""
    message = HealthEvent(
        kind=event.kind,
        cause=event.cause,
        state=int(event.state),
        severity=int(event.severity),
        quantity=to_quantity(event.quantity),
        message=event.message,
        source=event.source,
        code=event_kind(event.kind).cause(event.cause).code,
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(event.stamp)
    return message


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


def to_alarm_message(alarm: Alarm, valve_id: str) -> AlarmMessage:
    """Return ``alarm`` of the valve ``valve_id`` as a message."""
    message = AlarmMessage(
        namur=int(alarm.namur),
        state=int(alarm.state),
        underlying=int(alarm.underlying),
        severity=int(alarm.severity),
        **{name: getattr(alarm, name) for name in _ALARM_FIELDS},
        **{name: to_time(getattr(alarm, name)) for name in ("raised_at", "acknowledged_at", "shelved_until")},
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(alarm.changed_at)
    return message


def to_alarm_list(alarms: Iterable[Alarm], stamp: int, valve_id: str) -> AlarmList:
    """Return ``alarms`` in their order, published at ``stamp`` (ns)."""
    message = AlarmList(alarms=[to_alarm_message(alarm, valve_id) for alarm in alarms])
    message.header.frame_id = valve_id
    message.header.stamp = to_time(stamp)
    return message
