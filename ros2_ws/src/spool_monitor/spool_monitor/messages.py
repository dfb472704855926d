"""Health and events as messages."""

from __future__ import annotations

from spool_msgs.msg import HealthEvent, ValveHealth
from spool_node.messages import to_quantity, to_time

from .event import Event
from .monitor import Health

_QUANTITIES = (
    "dominant_frequency",
    "amplification",
    "natural_frequency",
    "viscous_drift",
    "coulomb_drift",
)


def to_event_message(event: Event, valve_id: str) -> HealthEvent:
    """Return ``event`` of the valve ``valve_id`` as a message."""
    message = HealthEvent(
        kind=event.kind,
        cause=event.cause,
        state=int(event.state),
        severity=int(event.severity),
        quantity=to_quantity(event.quantity),
        message=event.message,
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
        **{name: to_quantity(getattr(health, name)) for name in _QUANTITIES},
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(health.stamp)
    return message
