"""Sensor fault: what the faults of a channel have in common; each detector of one adds its cause."""

from __future__ import annotations

from spool_monitor.event import EventCause, EventKind, Namur


def sensor_fault(cause: EventCause) -> EventKind:
    """Return the kind of sensor faults with ``cause``."""
    return EventKind("sensor_fault", 600, Namur.FAILURE, latching=True, task="data", causes=(cause,))
