"""Data fault: blocks were lost or could not be used."""

from __future__ import annotations

import math

from spool_core.block_gate import BlockGate, Fault
from spool_core.kernels.samples import OutlierFilter
from spool_core.text import plural
from spool_core.uncertainty import Quantity, Validity, number

from spool_monitor.event import Condition, Event, EventCause, EventKind, Finding, Namur, Severity

KIND = EventKind(
    "data_fault",
    700,
    Namur.OUT_OF_SPECIFICATION,
    "Blocks were lost or could not be used.",
    "check network and measuring computer",
    task="data",
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
        EventCause(
            "outliers",
            705,
            "Single samples are impossible; they are left out, the others are used.",
            "check plugs and cables, interference, and what the driver sends where it has no reading",
        ),
        EventCause(
            "repeats",
            706,
            "A channel repeats its samples: the sensor is polled faster than it samples.",
            "poll the sensor at its own rate, or send the rate at which it samples",
            Namur.FAILURE,
        ),
        EventCause(
            "not_judged",
            710,
            "Blocks arrive, but no detector has been able to judge the valve for a minute.",
            "remove the cause that the message names; until then nothing is known of the valve",
            Namur.FAILURE,
        ),
    ),
)

#: Causes with a condition of their own, and those that make what is seen worthless.
SEPARATE, WORTHLESS = ("rate", "source", "clock_step"), ("rate", "clock_step")
#: Cause that does not come from the gate's judgement of a block.
OUTLIERS = "outliers"

#: s without a fault after which it is over; without an outlier, so that one every few seconds is one event.
OFF_DELAY, OUTLIERS_OFF = 5.0, 30.0


class DataFaultWatch:
    """Data faults of one valve: a condition for each cause that stands for itself, and one for the others."""

    def __init__(self) -> None:
        self.conditions = {source: Condition(KIND, 0.0, OFF_DELAY, source) for source in ("", *SEPARATE)}
        self._gate_conditions = dict(self.conditions)
        self.conditions[OUTLIERS] = Condition(KIND, 0.0, OUTLIERS_OFF, OUTLIERS)

    def judge(self, gate: BlockGate, stamp: int) -> list[Event]:
        """Return what follows from what ``gate`` found wrong with the newest block, at ``stamp`` (ns)."""
        fault = gate.fault
        cause = "" if fault is None else fault.cause
        severity = Severity.ALARM if cause in WORTHLESS else Severity.WARNING
        events: list[Event] = []
        for source, condition in self._gate_conditions.items():
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

    def judge_outliers(self, outliers: OutlierFilter, stamp: int) -> list[Event]:
        """Return what follows from the samples that were left out of the newest block, at ``stamp`` (ns)."""
        condition, found = self.conditions[OUTLIERS], outliers.first
        if found is None and condition.active is None:
            return []
        count = Quantity("outliers", "1", float(outliers.count), validity=Validity.VALID)
        severity = None if found is None else Severity.WARNING
        text = (
            f"{outliers.body} samples of the body and {outliers.spool} of the spool left out since the start"
        )
        if found is not None:
            span = (
                f"within +-{number(found.half_span, 2)} m/s^2"
                if math.isfinite(found.half_span)
                else "unknown"
            )
            text = (
                f"{found.channel}: a single sample of {number(found.value, 4)} m/s^2 while the signal's span "
                f"is {span}; {text}"
            )
        at = stamp if found is None else found.stamp
        return condition.judge(Finding(at, severity, found is None, OUTLIERS, count, text))


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
