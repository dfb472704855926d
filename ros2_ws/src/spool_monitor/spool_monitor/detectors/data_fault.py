"""Data fault: blocks were lost or could not be used."""

from __future__ import annotations

import math

from spool_stream.block_gate import BlockGate, Fault
from spool_stream.quantity import Quantity, Validity
from spool_stream.text.sentence import plural

from spool_monitor.events.condition import Condition, Finding
from spool_monitor.events.event import Event, Severity
from spool_monitor.events.event_kind import EventCause, EventKind, Namur

KIND = EventKind(
    "data_fault",
    700,
    Namur.OUT_OF_SPECIFICATION,
    "Blocks were lost or could not be used.",
    "check network and measuring computer",
    causes=(
        EventCause(
            "rate",
            701,
            "The sample period contradicts the time stamps; nothing is estimated from such data.",
            "correct the sample period that the source sends",
            Namur.FAILURE,
        ),
        EventCause(
            "source",
            702,
            "Two sources send on the same topic, or blocks name another valve; only the first one is used.",
            "end the second source or give it the namespace of its own valve",
        ),
        EventCause(
            "lost",
            703,
            "Blocks were lost on the way, as jumps in the sequence show.",
            "check network and load of the measuring computer",
        ),
        EventCause(
            "malformed",
            704,
            "Blocks had wrong lengths, samples, period or time stamps, or a clock was set.",
            "check the driver of the acquisition and the clock that its stamps come from",
        ),
        EventCause(
            "clock_step",
            707,
            "The clock of one sensor was set against the other's; nothing is estimated from such data.",
            "synchronise the clocks of both sensors, then restart the adapter",
            Namur.FAILURE,
        ),
    ),
)

#: Causes with a condition of their own, and those that make what is seen worthless.
SEPARATE, WORTHLESS = ("rate", "source", "clock_step"), ("rate", "clock_step")

#: s without a fault after which it is over.
OFF_DELAY = 5.0


class DataFaultWatch:
    """Data faults of one valve: a condition for each cause that stands for itself, and one for the others."""

    def __init__(self) -> None:
        self.conditions = {source: Condition(KIND, 0.0, OFF_DELAY, source) for source in ("", *SEPARATE)}

    def judge(self, gate: BlockGate, stamp: int) -> list[Event]:
        """Return what follows from what ``gate`` found wrong with the newest block, at ``stamp`` (ns)."""
        fault = gate.fault
        cause = "" if fault is None else fault.cause
        severity = Severity.ALARM if cause in WORTHLESS else Severity.WARNING
        events: list[Event] = []
        for source, condition in self.conditions.items():
            new = cause != "" and source == (cause if cause in SEPARATE else "")
            if new or condition.active is not None:
                count = float(_faulty(gate, cause or condition.cause))
                events += condition.judge(
                    Finding(
                        stamp,
                        severity if new else None,
                        not new,
                        cause if new else "",
                        Quantity("faulty_blocks", "1", count, validity=Validity.VALID),
                        _text(gate, fault if new else None),
                    )
                )
        return events


def _faulty(gate: BlockGate, cause: str) -> int:
    """Return how many blocks were faulty for ``cause``; of those that were lost, how many."""
    if cause == "lost":
        return gate.lost
    return sum(count for fault, count in gate.faults.items() if fault.cause == cause)


def _text(gate: BlockGate, fault: Fault | None) -> str:
    """Return what is wrong with the data in words."""
    counts = f"{plural(gate.lost, 'block')} lost, {gate.refused} refused since the start"
    if fault is None:
        return counts
    said = fault.value
    if fault is Fault.RATE and math.isfinite(gate.rate.departure):
        said = f"sample_period is {100.0 * gate.rate.departure:+.2g} % off what the stamps show"
    if fault is Fault.FOREIGN:
        said = f"frame_id says {gate.other!r} on the topic of {gate.source!r}"
    return f"{said}; {counts}"
