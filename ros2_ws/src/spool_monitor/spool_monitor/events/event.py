"""Event: something that began or ended on a valve."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from spool_core.uncertainty import Quantity


class EventState(enum.IntEnum):
    """State of an event; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    RAISED = 1
    CLEARED = 2


class Severity(enum.IntEnum):
    """Severity of an event; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    WARNING = 1
    ALARM = 2


def condition_name(kind: str, source: str) -> str:
    """Return the name of a condition of a valve, e.g. ``friction_drift/coulomb_force``."""
    return f"{kind}/{source}" if source else kind


@dataclass(frozen=True, slots=True)
class Event:
    """Event that began or ended at ``stamp`` (ns, acquisition time).

    ``source`` says which one of a kind's conditions it is, e.g. ``coulomb_force``; empty where there is one.
    """

    stamp: int
    kind: str
    state: EventState
    severity: Severity
    cause: str
    quantity: Quantity
    message: str
    source: str = ""
