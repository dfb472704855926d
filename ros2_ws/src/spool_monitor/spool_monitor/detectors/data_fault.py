"""Data fault: blocks were lost or could not be used."""

from __future__ import annotations

import math
from dataclasses import replace

from spool_core.block_gate import BlockGate, Fault
from spool_core.kernels.samples import OutlierFilter
from spool_core.one_source import Standing
from spool_core.rate_check import LIMIT as RATE_LIMIT
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.oil import COLDEST, HOTTEST, LONGEST_AGE, temperature_fault

from spool_monitor.estimate_gate import EstimateGate
from spool_monitor.event import (
    EACH_CHANNEL,
    Condition,
    Event,
    EventCause,
    EventKind,
    Facts,
    Finding,
    Namur,
    Severity,
)

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
        EventCause("overload", 709),
        EventCause("not_judged", 710, Namur.FAILURE),
        EventCause("temperature_unit", 711),
        EventCause("temperature_stamp", 712),
        EventCause("temperature_range", 713),
    ),
)

#: Cause where this computer dropped blocks.
OVERLOAD = "overload"
#: Which of the faults with one cause a block has, where there are several: each is a condition.
PARTS = {
    Fault.SECOND_SOURCE: "second",
    Fault.FOREIGN: "foreign",
    Fault.LENGTHS_DIFFER: "lengths",
    Fault.BAD_PERIOD: "period",
    Fault.NEW_PERIOD: "period",
    Fault.NOT_FINITE: "samples",
    Fault.NO_TIME: "no_time",
    Fault.TIME_BACK: "time",
    Fault.GAP: "time",
    Fault.NEW_TIME: "time",
    Fault.SEQUENCE_BACK: "sequence",
    Fault.SEQUENCE_AHEAD: "sequence",
}
#: Causes that make what is seen worthless.
WORTHLESS = ("rate", "clock_step")
#: Conditions that do not come from the gate's judgement of a block.
OUTLIERS, ESTIMATE = "outliers", "estimate"
TEMPERATURES = tuple(cause.name for cause in KIND.causes if cause.name.startswith("temperature"))
#: Conditions that do not end with a block.
APART = (ESTIMATE, *TEMPERATURES)

#: s without a fault after which it is over: of what makes the data worthless; of what comes and goes, so that
#: a block lost every half minute is one event; of outliers.
OFF_DELAY, COMES_AND_GOES, OUTLIERS_OFF = 5.0, 60.0, 30.0
#: s for which temperatures must be unusable: one reading at the start of a driver is no fault.
REFUSED = 2.0


def fault_source(fault: Fault) -> str:
    """Return the source of the condition of ``fault``, e.g. ``lost`` or ``malformed/samples``."""
    part = PARTS.get(fault, "")
    return f"{fault.cause}/{part}" if part else fault.cause


class DataFaultWatch:
    """Data faults of one valve: a condition for each kind of bad block, of outliers and of estimates."""

    def __init__(self) -> None:
        self.conditions = {
            source: Condition(KIND, 0.0, OFF_DELAY if fault.cause in WORTHLESS else COMES_AND_GOES, source)
            for fault in Fault
            if (source := fault_source(fault))
        }
        self._gate_conditions = dict(self.conditions)
        for name in EACH_CHANNEL:
            self.conditions[f"{OUTLIERS}/{name}"] = Condition(KIND, 0.0, OUTLIERS_OFF, f"{OUTLIERS}/{name}")
        self.conditions[ESTIMATE] = Condition(KIND, 0.0, COMES_AND_GOES, ESTIMATE)
        self._counted = dict.fromkeys(EACH_CHANNEL, 0)
        for cause in TEMPERATURES:
            self.conditions[cause] = Condition(KIND, REFUSED, COMES_AND_GOES, cause)
        self._refused = 0

    def judge(self, gate: BlockGate, stamp: int) -> list[Event]:
        """Return what follows from what is certainly wrong by ``gate``'s newest block, at ``stamp`` (ns)."""
        fault = gate.certain
        cause = "" if fault is None else fault.cause
        severity = Severity.ALARM if cause in WORTHLESS else Severity.WARNING
        events: list[Event] = []
        for source, condition in self._gate_conditions.items():
            new = fault is not None and source == fault_source(fault)
            if new or condition.active is not None:
                own, _, part = source.partition("/")
                faulty = sum(number for one, number in gate.faults.items() if fault_source(one) == source)
                count = _count("faulty_blocks", gate.lost if own == "lost" else faulty)
                facts = Facts.of(count, 0.0, part if own == "malformed" else "")
                if own == "rate":
                    departure = Quantity(
                        "period_departure", "1", gate.rate.departure, validity=Validity.VALID
                    )
                    facts = Facts.of(departure, math.copysign(RATE_LIMIT, gate.rate.departure))
                if new and fault is Fault.FOREIGN:
                    facts = replace(facts, subject=gate.other)
                elif new and fault is not None:
                    facts = replace(facts, note=fault.value)
                counts: tuple[Quantity, ...] = (
                    _count("lost_blocks", gate.lost),
                    _count("refused_blocks", gate.refused),
                )
                if own == OVERLOAD:
                    judged, sent = gate.judged_lately
                    count, counts = _count("judged_blocks", judged), (_count("sent_blocks", sent), *counts)
                    facts = Facts.of(count, note=facts.note)
                facts = replace(facts, evidence=counts)
                events += condition.judge(
                    Finding(stamp, severity if new else None, not new, own if new else "", count, facts)
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
        subject = "" if own or not new else gate.other
        note = note if new else ""
        # Of a replaced estimator there is nothing to count.
        facts = Facts.of(count, 0.0, subject, note) if gate.second else Facts(subject=subject, note=note)
        severity = Severity.WARNING if new else None
        return condition.judge(Finding(stamp, severity, not new, "source", count, facts))

    def judge_temperature(self, stamp: int, celsius: float, now: int) -> list[Event]:
        """Return what follows from a temperature (deg C) at ``stamp`` (ns); the data are at ``now`` (ns)."""
        cause = temperature_fault(stamp, celsius, now)
        self._refused += cause != ""
        count = _count("refused_temperatures", self._refused)
        facts = Facts.of(count, 0.0)
        if cause == "temperature_stamp":
            age = Quantity("temperature_age", "s", (now - stamp) * 1e-9, validity=Validity.VALID)
            facts = Facts.of(age, math.copysign(LONGEST_AGE, age.value)) if stamp > 0 else facts
        elif cause and math.isfinite(celsius):
            reading = Quantity("oil_temperature", "deg C", celsius, validity=Validity.VALID)
            facts = Facts.of(reading, HOTTEST if celsius > HOTTEST else COLDEST)
        events: list[Event] = []
        for name in TEMPERATURES:
            severity = Severity.WARNING if name == cause else None
            events += self.conditions[name].judge(Finding(now, severity, name != cause, name, count, facts))
        return events

    def judge_outliers(self, outliers: OutlierFilter, stamp: int, *, whole: bool = True) -> list[Event]:
        """Return what follows from the samples that were left out of the newest block, at ``stamp`` (ns).

        Those of a block that is not ``whole``, because of a stroke, are none.
        """
        events: list[Event] = []
        for name in EACH_CHANNEL:
            condition, count = self.conditions[f"{OUTLIERS}/{name}"], getattr(outliers, name)
            new, self._counted[name] = whole and count > self._counted[name], count
            if not new and condition.active is None:
                continue
            seen, first = _count(OUTLIERS, count), outliers.first
            facts = Facts.of(seen, 0.0, name)
            if new and first is not None and first.channel == name:
                sample = Quantity("outlier", "m/s^2", first.value, validity=Validity.VALID)
                span = Quantity("signal_span", "m/s^2", first.half_span, validity=Validity.VALID)
                facts = replace(facts, evidence=(sample, span))
            severity = Severity.WARNING if new else None
            at = first.stamp if new and first is not None else stamp
            events += condition.judge(Finding(at, severity, not new, OUTLIERS, seen, facts))
        return events


def _count(name: str, number: int) -> Quantity:
    return Quantity(name, "1", float(number), validity=Validity.VALID)
