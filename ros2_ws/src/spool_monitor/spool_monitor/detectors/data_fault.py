"""Data fault: blocks were lost or could not be used."""

from __future__ import annotations

import math
from dataclasses import replace

from spool_core.block_gate import BlockGate, Fault
from spool_core.kernels.samples import OutlierFilter
from spool_core.one_source import Standing
from spool_core.rate_check import LIMIT as RATE_LIMIT
from spool_core.uncertainty import Quantity, Validity

from spool_monitor.estimate_gate import EstimateGate
from spool_monitor.event import Condition, Event, EventCause, EventKind, Facts, Finding, Namur, Severity

KIND = EventKind(
    "data_fault",
    700,
    Namur.OUT_OF_SPECIFICATION,
    task="data",
    causes=(
        EventCause("rate", 701, Namur.FAILURE),
        EventCause("source", 702),
        EventCause("lost", 703),
        EventCause("malformed", 704),
        EventCause("clock_step", 707, Namur.FAILURE),
        EventCause("clock_drift", 708, Namur.FAILURE),
        EventCause("outliers", 705),
        EventCause("repeats", 706, Namur.FAILURE),
        EventCause("not_judged", 710, Namur.FAILURE),
    ),
)

#: Causes with a separate condition, and those that make what is seen worthless.
SEPARATE, WORTHLESS = ("rate", "source", "clock_step"), ("rate", "clock_step")
#: Conditions that do not come from the gate's judgement of a block.
OUTLIERS, ESTIMATE = "outliers", "estimate"

#: s without a fault after which it is over: of what makes the data worthless; of what comes and goes, so that
#: a block lost every half minute is one event; of outliers.
OFF_DELAY, COMES_AND_GOES, OUTLIERS_OFF = 5.0, 60.0, 30.0


class DataFaultWatch:
    """Data faults of one valve: a condition for each cause that stands for itself, and one for the others."""

    def __init__(self) -> None:
        self.conditions = {
            source: Condition(KIND, 0.0, OFF_DELAY if source in WORTHLESS else COMES_AND_GOES, source)
            for source in ("", *SEPARATE)
        }
        self._gate_conditions = dict(self.conditions)
        self.conditions[OUTLIERS] = Condition(KIND, 0.0, OUTLIERS_OFF, OUTLIERS)
        self.conditions[ESTIMATE] = Condition(KIND, 0.0, COMES_AND_GOES, ESTIMATE)

    def judge(self, gate: BlockGate, stamp: int) -> list[Event]:
        """Return what follows from what is certainly wrong by ``gate``'s newest block, at ``stamp`` (ns)."""
        fault = gate.certain
        cause = "" if fault is None else fault.cause
        severity = Severity.ALARM if cause in WORTHLESS else Severity.WARNING
        events: list[Event] = []
        for source, condition in self._gate_conditions.items():
            new = cause != "" and source == (cause if cause in SEPARATE else "")
            if new or condition.active is not None:
                own = cause or condition.cause
                faulty = sum(number for one, number in gate.faults.items() if one.cause == own)
                count = _count("faulty_blocks", gate.lost if own == "lost" else faulty)
                facts = Facts.of(count, 0.0)
                if own == "rate":
                    departure = Quantity(
                        "period_departure", "1", gate.rate.departure, validity=Validity.VALID
                    )
                    facts = Facts.of(departure, math.copysign(RATE_LIMIT, gate.rate.departure))
                if new and fault is Fault.FOREIGN:
                    facts = replace(facts, subject=gate.other)
                elif new and fault is not None:
                    facts = replace(facts, note=fault.value)
                counts = (_count("lost_blocks", gate.lost), _count("refused_blocks", gate.refused))
                facts = replace(facts, evidence=counts)
                events += condition.judge(
                    Finding(stamp, severity if new else None, not new, cause if new else "", count, facts)
                )
        return events

    def judge_estimate(self, gate: EstimateGate, stamp: int) -> list[Event]:
        """Return what follows from whose the newest estimate is, at ``stamp`` (ns)."""
        condition, second = self.conditions[ESTIMATE], gate.standing is Standing.SECOND
        new = second or gate.replaced
        if not new and (condition.active is None or gate.standing is not None):
            return []
        note = "a second estimator sends" if second else "the estimates are of another valve from now on"
        count = _count("second_estimates", gate.second)
        own = gate.last is not None and second and gate.other == gate.last.source
        facts = Facts.of(count, 0.0, "" if own or not new else gate.other, note if new else "")
        severity = Severity.WARNING if new else None
        return condition.judge(Finding(stamp, severity, not new, "source", count, facts))

    def judge_outliers(self, outliers: OutlierFilter, stamp: int) -> list[Event]:
        """Return what follows from the samples that were left out of the newest block, at ``stamp`` (ns)."""
        condition, found = self.conditions[OUTLIERS], outliers.first
        if found is None and condition.active is None:
            return []
        count = _count("outliers", outliers.count)
        severity = None if found is None else Severity.WARNING
        facts = Facts.of(count, 0.0, "" if found is None else found.channel)
        each = (_count("body_outliers", outliers.body), _count("spool_outliers", outliers.spool))
        if found is None:
            return condition.judge(
                Finding(stamp, severity, True, OUTLIERS, count, replace(facts, evidence=each))
            )
        sample = Quantity("outlier", "m/s^2", found.value, validity=Validity.VALID)
        span = Quantity("signal_span", "m/s^2", found.half_span, validity=Validity.VALID)
        facts = replace(facts, evidence=(sample, span, *each))
        return condition.judge(Finding(found.stamp, severity, False, OUTLIERS, count, facts))


def _count(name: str, number: int) -> Quantity:
    return Quantity(name, "1", float(number), validity=Validity.VALID)
