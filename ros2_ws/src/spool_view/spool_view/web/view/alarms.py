"""Alarms as browsers get them: states after ISA-18.2 by their names."""

from __future__ import annotations

from typing import Any

from spool_msgs.msg import Alarm, HealthEvent

#: Alarms that are held of one valve at most; a monitor has about twenty.
MOST = 60
STATES = {
    getattr(Alarm, name): name.removeprefix("STATE_").lower()
    for name in (
        "STATE_NORMAL", "STATE_UNACKNOWLEDGED", "STATE_ACKNOWLEDGED", "STATE_RETURNED_UNACKNOWLEDGED",
        "STATE_LATCHED_UNACKNOWLEDGED", "STATE_LATCHED_ACKNOWLEDGED", "STATE_SHELVED", "STATE_SUPPRESSED",
        "STATE_OUT_OF_SERVICE",
    )
}  # fmt: skip
_SEVERITIES = {HealthEvent.SEVERITY_WARNING: "warning", HealthEvent.SEVERITY_ALARM: "alarm"}
#: Characters of a text that are shown at most.
_LONGEST = 2000


def alarms_of(message: Any) -> tuple[dict[str, Any], ...]:
    """Return the alarms of an ``AlarmList`` that are not normal, in its order."""
    shown = [one for one in message.alarms if one.state != Alarm.STATE_NORMAL]
    return tuple(_alarm(one) for one in shown[:MOST])


def _alarm(alarm: Any) -> dict[str, Any]:
    return {
        "name": alarm.name[:_LONGEST],
        "code": int(alarm.code),
        "kind": alarm.kind[:_LONGEST],
        "cause": alarm.cause[:_LONGEST],
        "state": STATES.get(alarm.state, "unknown"),
        "underlying": STATES.get(alarm.underlying, "unknown"),
        "severity": _SEVERITIES.get(alarm.severity, "unknown"),
        "occurrence": int(alarm.occurrence),
        "message": alarm.message[:_LONGEST],
        "raised": int(alarm.raised_at.sec) or None,
        "acknowledged": int(alarm.acknowledged_at.sec) or None,
        "by": alarm.acknowledged_by[:_LONGEST],
        "comment": alarm.comment[:_LONGEST],
        "shelved_until": int(alarm.shelved_until.sec) or None,
    }
