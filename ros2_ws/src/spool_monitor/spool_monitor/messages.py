"""Messages of health, events and alarms."""

from __future__ import annotations

import math
from collections.abc import Iterable

from spool_core.events.english import Language
from spool_core.node.messages import to_event_message, to_quantity, to_time
from spool_msgs.msg import Alarm as AlarmMessage
from spool_msgs.msg import AlarmList, ValveHealth

from spool_monitor.alarm import Alarm
from spool_monitor.detectors import JUDGEMENT_TEXTS
from spool_monitor.monitor import Health

_QUANTITIES = ("dominant_frequency", "amplification", "natural_frequency", "viscous_drift", "coulomb_drift")

_ALARM_FIELDS = ("name", "kind", "cause", "code", "occurrence", "acknowledged_by", "comment")


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
        **{name: to_time(getattr(alarm, name)) for name in ("raised_at", "acknowledged_at", "shelved_until")},
    )
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
