"""Event of a valve as fields: what was judged, against what, since when, why, how sure, how urgent."""

from __future__ import annotations

import enum
import math
import re
from dataclasses import dataclass
from datetime import datetime, timezone

from spool_core.uncertainty import Z_95, Quantity


class EventState(enum.IntEnum):
    """Whether something began or ended; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    RAISED = 1
    CLEARED = 2


class Severity(enum.IntEnum):
    """Whether to look at it or to act; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    WARNING = 1
    ALARM = 2


class Namur(enum.IntEnum):
    """Status signal after NAMUR NE 107, a worse one above; numbers as in ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    NORMAL = 1
    MAINTENANCE_REQUIRED = 2  # M: works, but its reserve is running out
    OUT_OF_SPECIFICATION = 3  # S: is operated outside of what it was made for
    FUNCTION_CHECK = 4  # C: for now not valid, somebody works on it or it learns
    FAILURE = 5  # F: the signal is not valid

    @property
    def letter(self) -> str:
        """The letter that people know the status by; empty where all is well or nothing is known."""
        return {5: "F", 4: "C", 3: "S", 2: "M"}.get(int(self), "")


class Urgency(enum.IntEnum):
    """How soon somebody has to act; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    NONE = 1  # nobody has to act
    PLANNED = 2  # at the next planned stop
    SOON = 3  # within the shift
    IMMEDIATE = 4


def urgency_of(namur: Namur, severity: Severity, *, hurries: bool = False) -> Urgency:
    """Return how soon somebody has to act (ISA-18.2: by consequence and by the time that is left).

    Args:
        namur: status after NE 107 that the condition gives the valve: the consequence.
        severity: of the event.
        hurries: the limit of an alarm is reached before a planned stop.
    """
    alarm = severity is Severity.ALARM
    return {
        Namur.FAILURE: Urgency.IMMEDIATE,
        Namur.OUT_OF_SPECIFICATION: Urgency.IMMEDIATE if alarm else Urgency.SOON,
        Namur.MAINTENANCE_REQUIRED: Urgency.SOON if alarm or hurries else Urgency.PLANNED,
        Namur.FUNCTION_CHECK: Urgency.PLANNED,
    }.get(namur, Urgency.NONE)


@dataclass(frozen=True, slots=True)
class Facts:
    """Numbers and codes behind the texts. Unknown is NaN, 0 for stamps and codes, and empty for texts.

    Attributes:
        parameter: what was judged, e.g. ``coulomb_force``.
        unit: of ``value`` to ``limit``, SI; ``1`` for plain numbers.
        value: of the parameter at the event.
        low, high: ends of its 95 % interval.
        baseline: of the healthy valve.
        change: ``value`` less ``baseline``.
        limit: that the parameter passed.
        began: stamp (ns) at which the condition most likely began; of a cleared event: was raised.
        causes: possible causes, the most likely one first.
        probabilities: of the causes, 0 to 1.
        false_alarm_interval: mean time (s) between false alarms by drift of any parameter.
        urgency: how soon somebody has to act.
        time_to_limit: s until the limit of an alarm is reached at the present rate.
        advice: number of the advice: kind and cause; 0: there is nothing to do.
        subject: channel, topic or other valve that is meant, e.g. ``body``.
        note: code of a remark, e.g. ``at_rest``, or the remark itself.
        evidence: further numbers that belong to the event.
    """

    parameter: str = ""
    unit: str = "1"
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    baseline: float = math.nan
    change: float = math.nan
    limit: float = math.nan
    began: int = 0
    causes: tuple[str, ...] = ()
    probabilities: tuple[float, ...] = ()
    false_alarm_interval: float = math.nan
    urgency: Urgency = Urgency.UNKNOWN
    time_to_limit: float = math.nan
    advice: int = 0
    subject: str = ""
    note: str = ""
    evidence: tuple[Quantity, ...] = ()

    @classmethod
    def of(cls, quantity: Quantity, limit: float = math.nan, subject: str = "", note: str = "") -> Facts:
        """Return the facts of a quantity that was compared with ``limit``, in its unit."""
        value, half = quantity.value, Z_95 * quantity.standard_deviation
        return cls(
            quantity.name, quantity.unit, value, value - half, value + half,
            limit=limit, subject=subject, note=note,
        )  # fmt: skip

    @property
    def standard_deviation(self) -> float:
        """Standard deviation that belongs to the interval; NaN where there is none."""
        return (self.high - self.low) / (2.0 * Z_95)


@dataclass(frozen=True, slots=True)
class Event:
    """Something that began or ended at ``stamp`` (ns, acquisition time).

    Attributes:
        code: stable number of kind and cause.
        quantity: what was judged, at the moment of the event.
        source: which of the kind's conditions, e.g. ``coulomb_force``; empty where there is one.
        facts: everything else that is known.
        text: sentence of an event that has no facts: it was recorded by an earlier version.
    """

    stamp: int
    kind: str
    state: EventState
    severity: Severity
    cause: str
    quantity: Quantity
    source: str = ""
    code: int = 0
    facts: Facts = Facts()
    text: str = ""


def snapshot_name(valve: str, kind: str, stamp: int) -> str:
    """Return the name of the bag of the minutes around an event at ``stamp`` (ns).

    >>> snapshot_name("/press/valve_1", "resonance", 1_767_323_045_000_000_000)
    'press_valve_1_resonance_20260102T030405Z'
    """
    moment = f"{datetime.fromtimestamp(stamp * 1e-9, timezone.utc):%Y%m%dT%H%M%SZ}"
    own = valve.strip("/").replace("/", "_")
    return "_".join(filter(None, (own, re.sub(r"\W", "_", kind)[:40], moment)))
