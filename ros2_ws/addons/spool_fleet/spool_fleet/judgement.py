"""Judgement of a fleet: which valves change and why, as a table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.uncertainty import Z_95, as_json
from spool_monitor.detectors.friction_drift import COULOMB_CHANGE, VISCOUS_CHANGE
from spool_monitor.detectors.spring_change import STIFFNESS_CHANGE

from spool_fleet.comparison import LEAST_WEEKS, Change, Fleet, compare, pooled_slope
from spool_fleet.manifest import Service
from spool_fleet.observations import (
    BIN,
    COULOMB,
    PARAMETERS,
    STIFFNESS,
    VISCOUS,
    ObservedValve,
    observed_valves,
    weekly,
)
from spool_fleet.parquet import write_whole

OK, LEARNING, CHANGED, MACHINE, UNKNOWN = "ok", "learning", "changed", "machine_wide", "unknown"
#: Relative changes below which sensors explain it: half a kelvin of the oil's (IEC 60751, class B, at
#: 40 deg C) at 4 %/K; of the accelerometers' gain 0.02 %/K (piezoelectric ones' data sheets) over 50 K.
LEAST_CHANGE = {VISCOUS: 0.02, COULOMB: 0.01, STIFFNESS: 0.01}
#: Relative change that valves of a machine share below which it is no finding: half of what a viscosity grade
#: may differ by (ISO 3448: 10 %).
LEAST_SHARED = 0.05
#: What each service may step.
AFFECTED = {"oil_change": (VISCOUS, COULOMB), "spring_change": (STIFFNESS,), "repair": PARAMETERS}
#: What the monitor of a running valve warns at.
LIMITS = {VISCOUS: VISCOUS_CHANGE, COULOMB: COULOMB_CHANGE, STIFFNESS: STIFFNESS_CHANGE}

#: Machine, valve and parameter.
Key = tuple[str, str, str]
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


@dataclass(frozen=True, slots=True)
class Trend:
    """Trend of one parameter of one valve; relative changes, times in days since 1970.

    Attributes:
        machine, valve, parameter, unit: whose.
        bags: values it rests on.
        first, latest: of them.
        state: ``ok``, ``learning`` (too few weeks), ``changed``, ``machine_wide`` (all valves of the machine
            changed together) or ``unknown`` (with the reason).
        baseline, baseline_std: value before any change.
        change, change_std: relative, of what was found, or of what is likeliest where nothing was.
        since: when that began.
        noticed: when it could be seen first.
        rate, rate_std: relative change per month, where it grows.
        cause: of a change.
        reason: why nothing can be said.
    """

    machine: str
    valve: str
    parameter: str
    unit: str
    bags: int
    first: float
    latest: float
    state: str
    baseline: float = math.nan
    baseline_std: float = math.nan
    change: float = math.nan
    change_std: float = math.nan
    since: float = math.nan
    noticed: float = math.nan
    rate: float = math.nan
    rate_std: float = math.nan
    cause: str = ""
    reason: str = ""

    @property
    def key(self) -> Key:
        """Machine, valve and parameter."""
        return self.machine, self.valve, self.parameter

    @property
    def changed(self) -> bool:
        """Whether a change was found, of the valve or of its machine."""
        return self.state in (CHANGED, MACHINE)

    @property
    def limit(self) -> float:
        """Relative change at which the monitor of a running valve warns; NaN without a baseline."""
        one = LIMITS[self.parameter]
        return one.default if one.unit == "1" else one.default / self.baseline

    @property
    def threshold(self) -> float:
        """``limit`` with the sign of the change."""
        return math.copysign(self.limit, self.change)

    @property
    def share_of_limit(self) -> float:
        """Change in shares of ``threshold``; NaN where nothing changed."""
        return self.change / self.threshold if self.changed else math.nan

    def months_left(self) -> tuple[float, float, float]:
        """Return the months until the threshold is reached: expected, earliest, latest (NaN: none)."""
        left, unsure = self.threshold - self.change, Z_95 * self.change_std
        if self.state != CHANGED or not self.rate * self.change > 0.0:
            return math.nan, math.nan, math.nan
        if left * self.change <= 0.0:
            return 0.0, 0.0, 0.0
        most = abs(self.rate) + Z_95 * self.rate_std
        least = abs(self.rate) - Z_95 * self.rate_std
        earliest = max(0.0, abs(left) - unsure) / most
        return left / self.rate, earliest, (abs(left) + unsure) / least if least > 0.0 else math.nan


def judge(
    valves: Sequence[ObservedValve], services: Iterable[Service] = (), *, until: float = math.inf
) -> list[Trend]:
    """Return the trend of every parameter of ``valves``, by what was known on the day ``until``.

    What is found counts where it was found a week before as well: one odd week is no change.
    """
    days = [series.days.max() for valve in valves for series in valve.series.values() if series.days.size]
    latest = min(until, max(days, default=until))
    told = list(services)
    trends = judged_alone(valves, told, latest)
    if not any(one.changed for one in trends):
        return trends
    return confirmed(trends, judged_alone(valves, told, latest - BIN))


def stepping_days(services: Iterable[Service], valve: ObservedValve, parameter: str) -> list[float]:
    """Return the days of the services that may have stepped ``parameter`` of ``valve``."""
    return [
        one.day
        for one in services
        if one.concerns(*valve.key) and parameter in AFFECTED.get(one.kind, PARAMETERS)
    ]


def confirmed(trends: Sequence[Trend], before: Sequence[Trend]) -> list[Trend]:
    """Return ``trends`` with what was not found a week ``before`` as well taken for chance."""
    known = {one.key for one in before if one.changed}
    return [
        replace(one, state=OK, cause="", reason="") if one.changed and one.key not in known else one
        for one in trends
    ]


def judged_alone(valves: Sequence[ObservedValve], services: Sequence[Service], until: float) -> list[Trend]:
    """Return the trends by what was known on the day ``until`` alone."""
    told = [one for one in services if one.day <= until]
    found: dict[Key, Trend] = {}
    changes: dict[Key, Change] = {}
    for parameter in PARAMETERS:
        for referred in (True, False) if parameter == VISCOUS else (False,):
            own = [
                replace(valve, series={parameter: valve.series[parameter].until(until)})
                for valve in valves
                if parameter in valve.series and valve.series[parameter].referred is referred
            ]
            _judge_parameter(own, parameter, referred, told, found, changes)
    for key, change in changes.items():
        rubs = changes.get((*key[:2], COULOMB))
        found[key] = replace(found[key], cause=_cause(key[2], change, rubs))
    return [found[key] for key in sorted(found)]


def write_trends(store: Path, services: Sequence[Service]) -> list[Trend]:
    """Judge every valve of ``store``, write the tables ``trends`` and ``services``, return the trends."""
    write_whole(store, "services", [{**asdict(one), "start": _time(one.day)} for one in services])
    valves = observed_valves(store)
    trends = judge(valves, services)
    noticed = noticed_days({one.key: one.since for one in trends if one.changed}, valves, services)
    trends = [replace(one, noticed=noticed.get(one.key, math.nan)) for one in trends]
    write_whole(store, "trends", as_json([_row(one) for one in trends]))
    return trends


def noticed_days(
    changed: Mapping[Key, float], valves: Sequence[ObservedValve], services: Sequence[Service]
) -> dict[Key, float]:
    """Return the day on which each of the ``changed`` could be seen first, and ever since.

    ``changed`` says since which day it is so; what had to be seen twice was seen a week before as well.
    """
    if not changed:
        return {}
    last = max(series.days.max() for valve in valves for series in valve.series.values() if series.days.size)
    found = dict.fromkeys(changed, last)
    still, day = set(changed), last - BIN
    before = _seen(valves, services, day)
    while still and day > min(changed[key] for key in still):
        today, day = before, day - BIN
        before = _seen(valves, services, day)
        still = {key for key in still if key in today and key in before}
        found |= dict.fromkeys(still, day + BIN)
    return found


def sentences(trends: Sequence[Trend]) -> list[str]:
    """Return a line for each valve that changed, and one about those that cannot be judged."""
    lines = [_sentence(one) for one in trends if one.state == CHANGED]
    shared: dict[tuple[str, str], list[Trend]] = {}
    for one in trends:
        if one.state == MACHINE:
            shared.setdefault((one.machine, one.parameter), []).append(one)
    for same in shared.values():
        middle = sorted(same, key=lambda one: one.change)[len(same) // 2]
        lines.append(f"{_sentence(middle)}; {middle.reason}")
    waiting = {(one.machine, one.valve) for one in trends if one.state in (LEARNING, UNKNOWN)}
    judged = {(one.machine, one.valve) for one in trends} - waiting
    lines.append(
        f"{len(judged)} valves judged" + (f", {len(waiting)} not in every parameter yet" if waiting else "")
    )
    return lines


def _judge_parameter(
    valves: Sequence[ObservedValve],
    parameter: str,
    referred: bool,
    services: Sequence[Service],
    found: dict[Key, Trend],
    changes: dict[Key, Change],
) -> None:
    stepped = [stepping_days(services, valve, parameter) for valve in valves]
    weeks = [weekly(valve.series[parameter], days) for valve, days in zip(valves, stepped, strict=True)]
    thermal = referred if parameter == VISCOUS else None
    if thermal is not None:
        slope, _ = pooled_slope(weeks, thermal)
        weeks = [
            weekly(one.series[parameter], days, slope) for one, days in zip(valves, stepped, strict=True)
        ]
    machines = [valve.machine for valve in valves]
    compared = compare(Fleet(weeks, machines, stepped, len(PARAMETERS), thermal))
    for number, (valve, own, change) in enumerate(zip(valves, weeks, compared.valves, strict=True)):
        key, series = (*valve.key, parameter), valve.series[parameter]
        if series.days.size == 0:
            continue
        found[key] = Trend(
            *valve.key, parameter, series.unit, int(series.days.size), float(series.days.min()),
            float(series.days.max()), LEARNING,
            reason=f"{own.week.size} weeks with bags, {LEAST_WEEKS} are needed",
        )  # fmt: skip
        cold = thermal is False and not np.isfinite(series.temperature).all()
        if cold and number in compared.alone:
            found[key] = replace(found[key], state=UNKNOWN, reason="the oil temperature is not recorded")
        elif change is not None:
            shared = compared.machines.get(valve.machine)
            if number in compared.found and abs(change.size) > LEAST_CHANGE[parameter]:
                found[key] = _trend(found[key], change, CHANGED)
                changes[key] = change
            elif shared is not None and abs(shared.size) > LEAST_SHARED:
                level = replace(shared, level=change.level, level_deviation=change.level_deviation)
                cause = {VISCOUS: "oil_viscosity", COULOMB: "oil_contamination"}.get(parameter, "unknown")
                reason = f"the valves of {valve.machine} changed together"
                found[key] = replace(_trend(found[key], level, MACHINE), cause=cause, reason=reason)
            else:
                found[key] = _trend(found[key], change, OK)


def _trend(trend: Trend, change: Change, state: str) -> Trend:
    level = math.exp(change.level)
    size = math.expm1(change.size)
    return replace(
        trend,
        state=state,
        baseline=level,
        baseline_std=level * change.level_deviation,
        change=size,
        change_std=(1.0 + size) * change.deviation,
        since=change.week * BIN,
        rate=math.expm1(change.rate) if change.ramp else math.nan,
        rate_std=math.exp(change.rate) * change.rate_deviation if change.ramp else math.nan,
        reason="",
    )


def _cause(parameter: str, change: Change, rubs: Change | None) -> str:
    """Return the cause, as the monitor names it: a wider gap drags less, dirt and varnish rub more."""
    if parameter == STIFFNESS:
        return "spring_change"
    if rubs is not None and rubs.size > 0.0:
        return "oil_contamination" if parameter == COULOMB or change.size > 0.0 else "wear"
    if parameter == VISCOUS:
        return "wear" if change.size < 0.0 else "oil_viscosity"
    return "unknown"


def _seen(valves: Sequence[ObservedValve], services: Sequence[Service], day: float) -> set[Key]:
    """Return what the data until ``day`` show, seen once."""
    return {one.key for one in judged_alone(valves, services, day) if one.changed}


def _sentence(one: Trend) -> str:
    since = (_EPOCH + timedelta(days=one.since)).strftime("%Y-%m-%d")
    where = f"{one.machine} {one.valve}" if one.state == CHANGED else one.machine
    grows = "" if math.isnan(one.rate) else f", {100.0 * one.rate:+.1f} % a month"
    expected, earliest, latest = one.months_left()
    left = ""
    if expected > 0.0:
        end = "open" if math.isnan(latest) else f"{latest:.1f}"
        left = f"; at the monitor's limit in {expected:.1f} months ({earliest:.1f} to {end})"
    size = f"{one.parameter.replace('_', ' ')} {100.0 * one.change:+.1f} % since {since}{grows}"
    return f"{where}: {size}: {one.cause.replace('_', ' ')}{left}"


def _row(one: Trend) -> dict[str, Any]:
    expected, earliest, latest = one.months_left()
    return {
        "machine": one.machine, "valve": one.valve, "parameter": one.parameter, "unit": one.unit,
        "bags": one.bags, "first": _time(one.first), "latest": _time(one.latest),
        "baseline": one.baseline, "baseline_std": one.baseline_std, "state": one.state,
        "cause": one.cause or None, "since": _time(one.since) if one.changed else None,
        "noticed": _time(one.noticed),
        "change": one.change, "change_std": one.change_std,
        "rate_per_month": one.rate, "rate_per_month_std": one.rate_std,
        "threshold": one.threshold if one.changed else None,
        "months_to_threshold": expected, "months_earliest": earliest,
        "months_latest": latest, "reason": one.reason or None,
    }  # fmt: skip


def _time(day: float) -> datetime | None:
    return _EPOCH + timedelta(days=day) if math.isfinite(day) else None
