"""Courses of a valve's parameters over time, relative to the healthy valve, as the page draws them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_core.uncertainty import Z_95

from spool_fleet.tables.query import ask
from spool_fleet.trends.judgement import AFFECTED
from spool_fleet.trends.observations import PARAMETERS, VISCOUS, ObservedValve, Series
from spool_fleet.trends.sisters import pooled_slope
from spool_fleet.trends.weekly import BIN, REFERENCE, weekly

from .levels import Level, levels_of
from .trend_rows import NAMES, TrendRow

Array = NDArray[np.float64]
#: Points of a course at most: two years of weeks; a chart has hardly more columns of pixels to tell apart.
MOST_POINTS = 104


@dataclass(frozen=True, slots=True)
class Told:
    """Service that was told: the day, what was done, what was said about it."""

    machine: str
    valve: str
    day: float
    kind: str
    comment: str

    def concerns(self, machine: str, valve: str) -> bool:
        """Return whether it was done to this valve."""
        return self.machine in ("", machine) and self.valve in ("", valve)


@dataclass(frozen=True, slots=True)
class Points:
    """Points of a course by time: day, value, 95 % interval; all of one length."""

    day: Array
    value: Array
    low: Array
    high: Array


@dataclass(frozen=True, slots=True)
class Course:
    """Course of one parameter of one valve.

    Attributes:
        parameter, title, unit: which; the title says at which oil temperature.
        points: weekly medians, relative to ``baseline`` (1: as it), with the interval of the estimates.
        baseline: that of the trend; where there is none (``judged`` false), the median so far.
        levels: the baseline, and after each service what was usual since; until a change begins.
        limit: relative change at which the monitor of the running valve warns.
        trend: what was found.
    """

    parameter: str
    title: str
    unit: str
    points: Points
    baseline: float
    judged: bool
    levels: tuple[Level, ...]
    limit: float
    trend: TrendRow
    services: tuple[Told, ...] = field(default=())

    @property
    def largest(self) -> float:
        """Largest difference from the baseline, relative."""
        seen = np.abs(self.points.value - 1.0)
        found = self.trend.change if self.trend.changed else 0.0
        return max(float(seen.max(initial=0.0)), abs(found))


def services_told(store: Path) -> tuple[Told, ...]:
    """Return the service events by time."""
    rows = ask(
        store,
        "SELECT machine, valve, epoch(start) / 86400.0 AS day, kind, comment FROM services ORDER BY start",
    ).to_pylist()
    return tuple(
        Told(row["machine"] or "", row["valve"] or "", row["day"], row["kind"], row["comment"] or "")
        for row in rows
    )


def temperature_slopes(valves: Sequence[ObservedValve], services: Sequence[Told]) -> dict[bool, float]:
    """Return the slope of the viscous coefficient's logarithm on the oil temperature, 1/K.

    It is that of the trends: one for values that are ``referred`` to a temperature already, and one for those
    that are not.
    """
    found = {}
    for referred in (True, False):
        weeks = [
            weekly(valve.series[VISCOUS], [one.day for one in _stepping(services, valve, VISCOUS)])
            for valve in valves
            if VISCOUS in valve.series and valve.series[VISCOUS].referred is referred
        ]
        if weeks:
            found[referred] = pooled_slope(weeks, referred)[0]
    return found


def courses_of(
    valve: ObservedValve, trends: Sequence[TrendRow], services: Sequence[Told], slopes: Mapping[bool, float]
) -> dict[str, Course]:
    """Return the course of each parameter of ``valve`` that has a trend; ``slopes`` as above."""
    found = {}
    for trend in trends:
        series = valve.series.get(trend.parameter)
        if series is not None and series.days.size:
            slope = slopes[series.referred] if trend.parameter == VISCOUS else 0.0
            stepping = _stepping(services, valve, trend.parameter)
            own = tuple(one for one in services if one.concerns(*valve.key))
            found[trend.parameter] = _course(series, trend, slope, [one.day for one in stepping], own)
    return found


def temperatures(store: Path) -> dict[tuple[str, str], tuple[Array, Array]]:
    """Return the oil temperature of each valve: days, and the weekly mean in deg C."""
    table = ask(
        store,
        f"SELECT machine, valve, floor(epoch(start) / 86400.0 / {BIN:g}) AS week, "
        "avg(oil_temperature_C) AS celsius FROM bags WHERE status = 'ok' "
        "AND isfinite(oil_temperature_C) GROUP BY ALL ORDER BY machine, valve, week",
    )
    rows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in table.to_pylist():
        day = BIN * (row["week"] + 0.5)
        rows.setdefault((row["machine"], row["valve"]), []).append((day, row["celsius"]))
    found = {}
    for key, pairs in rows.items():
        days, values = np.array(pairs).T
        found[key] = (_thinned(days), _thinned(values))
    return found


def _stepping(services: Sequence[Told], valve: ObservedValve, parameter: str) -> list[Told]:
    """Return the services that may have stepped a parameter of ``valve``."""
    return [
        one
        for one in services
        if one.concerns(*valve.key) and parameter in AFFECTED.get(one.kind, PARAMETERS)
    ]


def _course(
    series: Series, trend: TrendRow, slope: float, turns: Sequence[float], services: tuple[Told, ...]
) -> Course:
    known = np.isfinite(series.temperature)
    warm = np.where(known, series.temperature - REFERENCE, 0.0)
    row = series.logarithm - slope * warm
    segment = np.searchsorted(np.array(turns), series.days, side="right")
    judged = trend.baseline > 0.0
    baseline = trend.baseline if judged else float(np.exp(np.median(row)))
    day, value, variance, segments = _weeks(series.days, row, series.deviation, segment)
    relative = value - math.log(baseline)
    half = _thinned(Z_95 * np.sqrt(variance))
    middle = np.exp(_thinned(relative))
    cold = trend.parameter == VISCOUS and (series.referred or bool(known.all()))
    return Course(
        trend.parameter,
        NAMES[trend.parameter] + (f" at {REFERENCE:g} °C" if cold else ""),
        series.unit,
        Points(_thinned(day), middle, middle * np.exp(-half), middle * np.exp(half)),
        baseline,
        judged,
        levels_of(day, np.exp(relative), segments, trend, turns),
        trend.limit,
        trend,
        services,
    )


def _weeks(
    days: Array, row: Array, deviation: Array, segment: NDArray[np.int64]
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Return day, median, variance of that, and segment of each week, those of a service's week apart.

    The variance is that which the bags state, or that of their scatter where that is larger.
    """
    order = np.argsort(days, kind="stable")
    days, row, deviation, segment = days[order], row[order], deviation[order], segment[order]
    week = np.floor(days / BIN)
    begins = np.flatnonzero((np.diff(week) != 0.0) | (np.diff(segment) != 0)) + 1
    ends = [*begins.tolist(), days.size]
    found, begin = [], 0
    for end in ends:
        own = slice(begin, end)
        stated = float(np.mean(deviation[own] ** 2))
        scatter = float(np.var(row[own], ddof=1)) if end - begin > 1 else 0.0
        variance = max(stated, scatter) / (end - begin)
        found.append((float(np.mean(days[own])), float(np.median(row[own])), variance, segment[begin]))
        begin = end
    columns = np.array(found).T
    return columns[0], columns[1], columns[2], columns[3].astype(np.int64)


def _thinned(row: Array) -> Array:
    """Return medians of neighbours, so many that ``MOST_POINTS`` are left at most."""
    size = math.ceil(row.size / MOST_POINTS)
    if size <= 1:
        return row
    return np.array([np.median(row[begin : begin + size]) for begin in range(0, row.size, size)])
