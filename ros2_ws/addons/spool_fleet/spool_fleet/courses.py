"""Courses of parameters over time: the rows of trends, their levels, and what is drawn of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95

from spool_fleet.comparison import LEAST_WEEKS, pooled_slope
from spool_fleet.judgement import Trend, stepping_days
from spool_fleet.manifest import DAY, Service
from spool_fleet.observations import (
    BIN,
    COULOMB,
    PARAMETERS,
    STIFFNESS,
    VISCOUS,
    ObservedValve,
    spread,
    weekly,
)
from spool_fleet.parquet import REFERENCE
from spool_fleet.query import ask

#: Points of a course at most: two years of weeks; a chart has hardly more columns of pixels to tell apart.
MOST_POINTS = 104

#: What people call the parameters.
NAMES = {VISCOUS: "viscous coefficient", COULOMB: "Coulomb force", STIFFNESS: "spring stiffness"}


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
    trend: Trend
    services: tuple[Service, ...] = field(default=())

    @property
    def largest(self) -> float:
        """Largest difference from the baseline, relative."""
        seen = np.abs(self.points.value - 1.0)
        found = self.trend.change if self.trend.changed else 0.0
        return max(float(seen.max(initial=0.0)), abs(found))


def services_told(store: Path) -> tuple[Service, ...]:
    """Return the service events by time."""
    rows = ask(
        store,
        "SELECT machine, valve, 1000 * epoch_us(start) AS start, kind, comment FROM services ORDER BY start",
    ).to_pylist()
    return tuple(
        Service(row["machine"] or "", row["valve"] or "", row["start"], row["kind"], row["comment"] or "")
        for row in rows
    )


def temperature_slopes(valves: Sequence[ObservedValve], services: Sequence[Service]) -> dict[bool, float]:
    """Return the slope of the viscous coefficient's logarithm on the oil temperature, 1/K.

    It is that of the trends: one for values that are ``referred`` to a temperature already, and one for those
    that are not.
    """
    found = {}
    for referred in (True, False):
        weeks = [
            weekly(valve.series[VISCOUS], stepping_days(services, valve, VISCOUS))
            for valve in valves
            if VISCOUS in valve.series and valve.series[VISCOUS].referred is referred
        ]
        if weeks:
            found[referred] = pooled_slope(weeks, referred)[0]
    return found


def courses_of(
    valve: ObservedValve, trends: Sequence[Trend], services: Sequence[Service], slopes: Mapping[bool, float]
) -> dict[str, Course]:
    """Return the course of each parameter of ``valve`` that has a trend; ``slopes`` as above."""
    found = {}
    for trend in trends:
        series = valve.series.get(trend.parameter)
        if series is not None and series.days.size:
            slope = slopes[series.referred] if trend.parameter == VISCOUS else 0.0
            turns = stepping_days(services, valve, trend.parameter)
            own = tuple(one for one in services if one.concerns(*valve.key))
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
            found[trend.parameter] = Course(
                trend.parameter,
                NAMES[trend.parameter] + (f" at {REFERENCE:g} °C" if cold else ""),
                series.unit,
                Points(_thinned(day), middle, middle * np.exp(-half), middle * np.exp(half)),
                baseline,
                judged,
                levels_of(day, np.exp(relative), segments, trend, turns),
                trend.limit,
                trend,
                own,
            )
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


@dataclass(frozen=True, slots=True)
class Level:
    """Level around which a parameter stays from day ``first`` to ``last``, relative to the baseline.

    95 % of the weeks in which nothing changed lie within ``half_width`` of it; NaN: there are too few.
    """

    first: float
    last: float
    value: float
    half_width: float


def levels_of(
    day: Array, value: Array, segment: NDArray[np.int64], trend: Trend, turns: Sequence[float]
) -> tuple[Level, ...]:
    """Return the baseline until the first service, and the usual value after each until a change begins.

    The table of trends holds the first baseline alone, so a later one is the median of its weeks.

    Args:
        day, value, segment: of each week, shape (n,); segments are the services before it.
        trend: of the parameter.
        turns: days of the services that may have stepped it.
    """
    if not day.size:
        return ()
    first, last = float(day[0]), float(day[-1])
    if not trend.baseline > 0.0:
        return (Level(first, last, 1.0, math.nan),)
    healthy = day < trend.since if trend.changed else np.ones(day.size, dtype=bool)
    begins, ends = [first, *turns], [*turns, last]
    found, around = [], [np.empty(0)]
    for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        own = value[healthy & (segment == number)]
        if own.size:
            around.append(own / np.median(own))
        if own.size or (number == 0 and begin < end):
            found.append((begin, end, float(np.median(own)) if number else 1.0))
    rows = np.concatenate(around)
    half = Z_95 * spread(rows) if rows.size >= LEAST_WEEKS else math.nan
    return tuple(Level(begin, end, middle, half * middle) for begin, end, middle in found)


def trend_rows(store: Path) -> dict[tuple[str, str], list[Trend]]:
    """Return the trends by valve, in the order of ``PARAMETERS``."""
    found: dict[tuple[str, str], list[Trend]] = {}
    for row in ask(store, "trends").to_pylist():
        if row["parameter"] not in PARAMETERS:
            continue
        known = {name: math.nan if value is None else value for name, value in row.items()}
        one = Trend(
            row["machine"], row["valve"], row["parameter"], row["unit"] or "", row["bags"] or 0,
            day_of(row["first"]), day_of(row["latest"]), row["state"], known["baseline"],
            known["baseline_std"], known["change"], known["change_std"], day_of(row["since"]),
            day_of(row["noticed"]), known["rate_per_month"], known["rate_per_month_std"],
            row["cause"] or "", row["reason"] or "",
        )  # fmt: skip
        found.setdefault((one.machine, one.valve), []).append(one)
    for trends in found.values():
        trends.sort(key=lambda one: PARAMETERS.index(one.parameter))
    return found


def day_of(moment: datetime | None) -> float:
    """Return ``moment`` in days since 1970."""
    return math.nan if moment is None else moment.timestamp() / DAY


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
