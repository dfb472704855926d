"""Table of the trends: judged from the store's tables, written beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from spool_fleet.catalogue.manifest import Service
from spool_fleet.tables.parquet import write_whole

from .judgement import CHANGED, LEARNING, MACHINE, UNKNOWN, Trend, judge, judged_alone
from .observations import DAY, ObservedValve, observed_valves
from .weekly import BIN

#: Machine, valve and parameter.
Key = tuple[str, str, str]
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


def write_trends(store: Path, services: Sequence[Service]) -> list[Trend]:
    """Judge every valve of ``store``, write the tables ``trends`` and ``services``, return the trends."""
    rows = [
        {
            "machine": one.machine, "valve": one.valve, "start": _time(one.start / 1e9 / DAY),
            "kind": one.kind, "comment": one.comment,
        }
        for one in services
    ]  # fmt: skip
    write_whole(store, "services", rows)
    valves = observed_valves(store)
    trends = judge(valves, services)
    changed = {one.key: one.since for one in trends if one.state in (CHANGED, MACHINE)}
    noticed = noticed_days(changed, valves, services)
    write_whole(store, "trends", [_row(one, noticed) for one in trends])
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


def _seen(valves: Sequence[ObservedValve], services: Sequence[Service], day: float) -> set[Key]:
    """Return what the data until ``day`` show, seen once."""
    return {one.key for one in judged_alone(valves, services, day) if one.state in (CHANGED, MACHINE)}


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


def _row(one: Trend, noticed: Mapping[Key, float]) -> dict[str, Any]:
    expected, earliest, latest = one.months_left()
    changed = one.state in (CHANGED, MACHINE)
    return {
        "machine": one.machine, "valve": one.valve, "parameter": one.parameter, "unit": one.unit,
        "bags": one.bags, "first": _time(one.first), "latest": _time(one.latest),
        "baseline": _number(one.baseline), "baseline_std": _number(one.baseline_std), "state": one.state,
        "cause": one.cause or None, "since": _time(one.since) if changed else None,
        "noticed": _time(noticed.get(one.key, math.nan)),
        "change": _number(one.change), "change_std": _number(one.change_std),
        "rate_per_month": _number(one.rate), "rate_per_month_std": _number(one.rate_std),
        "threshold": _number(one.threshold) if changed else None,
        "months_to_threshold": _number(expected), "months_earliest": _number(earliest),
        "months_latest": _number(latest), "reason": one.reason or None,
    }  # fmt: skip


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _time(day: float) -> datetime | None:
    return _EPOCH + timedelta(days=day) if math.isfinite(day) else None
