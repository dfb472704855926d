"""Observations of a valve: estimates over time, week by week."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import MEDIAN_TO_DEVIATION, Array

from spool_fleet.parquet import REFERENCE, REFERRED
from spool_fleet.query import ask

VISCOUS, COULOMB, STIFFNESS = "viscous_coefficient", "coulomb_force", "spring_stiffness"
#: Parameters that wear, dirt and springs change.
PARAMETERS = (VISCOUS, COULOMB, STIFFNESS)
#: Relative standard deviation above which a bag says nothing of a parameter, as in the monitor.
UNCERTAIN = 0.35

#: Days of a bin: a week evens out shifts and weekends.
BIN = 7.0
#: Standard deviations beyond which a value is clipped, and what that leaves of the mean square of a normal
#: distribution (by integration).
CLIP, CLIPPED_SQUARE = 2.5, 0.977


@dataclass(frozen=True, slots=True)
class Series:
    """Series of one parameter of one valve, by time.

    Attributes:
        days: since 1970, shape (n,).
        logarithm: of the value, shape (n,).
        deviation: standard deviation of that, shape (n,).
        temperature: of the oil, deg C, NaN where it was not measured, shape (n,).
        unit: of the value.
        referred: the values hold at one oil temperature.
    """

    days: Array
    logarithm: Array
    deviation: Array
    temperature: Array
    unit: str
    referred: bool = False

    def until(self, day: float) -> Series:
        """Return what was known on ``day``."""
        known = self.days <= day
        return Series(
            self.days[known], self.logarithm[known], self.deviation[known], self.temperature[known],
            self.unit, self.referred,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ObservedValve:
    """Its series by parameter."""

    machine: str
    valve: str
    series: dict[str, Series] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str]:
        """Machine and valve."""
        return self.machine, self.valve


def observed_valves(store: Path) -> list[ObservedValve]:
    """Return the valves of the tables; a fit counts before the monitor's estimate where a bag has both.

    The viscous coefficient is the one referred to a temperature where every bag of the valve has it.
    """
    names = ", ".join(f"'{name}'" for name in (*PARAMETERS, REFERRED))
    table = ask(
        store,
        "SELECT p.machine, p.valve, p.name, p.unit, epoch(p.start) / 86400.0 AS day, p.value, p.std, "
        "b.oil_temperature_C AS temperature, p.bag FROM parameters p "
        "JOIN bags b ON b.bag = p.bag AND b.valve = p.valve "
        f"WHERE p.analysis IN ('fit', 'monitor') AND p.name IN ({names}) AND p.value > 0 AND p.std >= 0 "
        "AND b.status = 'ok' "
        "QUALIFY row_number() OVER (PARTITION BY p.bag, p.valve, p.name ORDER BY p.analysis) = 1 "
        "ORDER BY p.machine, p.valve, p.name, p.start, p.bag",
    )
    columns = {name: table.column(name).to_pylist() for name in ("machine", "valve", "name", "unit")}
    numbers = {
        name: np.array(table.column(name).to_numpy(zero_copy_only=False), dtype=np.float64)
        for name in ("day", "value", "std", "temperature")
    }
    rows: dict[tuple[str, str], dict[str, list[int]]] = {}
    for number, (machine, valve, name) in enumerate(
        zip(columns["machine"], columns["valve"], columns["name"], strict=True)
    ):
        rows.setdefault((machine, valve), {}).setdefault(name, []).append(number)
    found = []
    for (machine, valve), named in rows.items():
        drag = named.pop(REFERRED, [])
        referred = bool(drag) and len(drag) >= len(named.get(VISCOUS, []))
        if referred:
            named[VISCOUS] = drag
        series = {
            name: _series(numbers, np.array(own), columns["unit"][own[0]], referred and name == VISCOUS)
            for name, own in named.items()
        }
        found.append(ObservedValve(machine, valve, series))
    return found


@dataclass(frozen=True, slots=True)
class Weekly:
    """Weekly values of one parameter of a valve, as logarithms without what the oil temperature does.

    Attributes:
        week: number since 1970, shape (n,).
        value: shape (n,).
        count: bags of each week, shape (n,).
        temperature: of the oil, deg C, NaN where it was not measured, shape (n,).
        segment: services before each, shape (n,).
        bag_variance: of one bag around its week, NaN where weeks have one bag.
        freedom: degrees of freedom of that.
    """

    week: NDArray[np.int64]
    value: Array
    count: Array
    temperature: Array
    segment: NDArray[np.int64]
    bag_variance: float = math.nan
    freedom: float = 0.0


def weekly(series: Series, services: Sequence[float] = (), slope: float = 0.0) -> Weekly:
    """Return the middles of the weeks that have bags; of the week of a service what came after it counts.

    ``slope`` on the oil temperature, 1/K, is taken off.
    """
    number = np.floor(series.days / BIN).astype(np.int64)
    stale = np.zeros(number.size, dtype=bool)
    for day in services:
        stale |= (number == week_of(day)) & (series.days < day)
    warm = np.where(np.isfinite(series.temperature), series.temperature - REFERENCE, 0.0)
    row, number = (series.logarithm - slope * warm)[~stale], number[~stale]
    celsius = series.temperature[~stale]
    weeks = np.unique(number)
    value, count, temperature = (np.empty(weeks.size) for _ in range(3))
    around: list[Array] = []
    for place, week in enumerate(weeks):
        own = row[number == week]
        value[place], count[place] = middle(own), own.size
        if own.size > 1:
            around.append((own - own.mean()) * math.sqrt(own.size / (own.size - 1.0)))
        known = celsius[number == week]
        known = known[np.isfinite(known)]
        temperature[place] = known.mean() if known.size else np.nan
    segment = np.sum([weeks >= week_of(day) for day in services], axis=0, dtype=np.int64)
    within = np.concatenate(around) if around else np.empty(0)
    return Weekly(
        weeks,
        value,
        count,
        temperature,
        np.broadcast_to(segment, weeks.shape),
        mean_square(within) if within.size > 1 else math.nan,
        float(np.sum(count - 1.0)),
    )


def middle(values: Array) -> float:
    """Return Hodges and Lehmann's median of pairwise means: robust, with 95 % of the mean's efficiency."""
    row: list[float] = values.tolist()
    return median([0.5 * (one + other) for place, one in enumerate(row) for other in row[place:]])


def week_of(day: float) -> int:
    """Return the number of the week in which ``day`` lies."""
    return int(day // BIN)


def spread(values: Array) -> float:
    """Return the robust standard deviation of ``values`` around their median; NaN for fewer than two."""
    if values.size < 2:
        return math.nan
    return float(MEDIAN_TO_DEVIATION * np.median(np.abs(values - np.median(values))))


def mean_square(values: Array) -> float:
    """Return the mean square of ``values`` with outliers clipped."""
    limit = CLIP * MEDIAN_TO_DEVIATION * float(np.median(np.abs(values)))
    return float(np.mean(np.minimum(np.abs(values), limit) ** 2)) / CLIPPED_SQUARE


def _series(numbers: dict[str, Array], rows: NDArray[np.int64], unit: str, referred: bool) -> Series:
    value, std = numbers["value"][rows], numbers["std"][rows]
    certain = std <= UNCERTAIN * value
    return Series(
        numbers["day"][rows][certain],
        np.log(value[certain]),
        (std / value)[certain],
        numbers["temperature"][rows][certain],
        unit,
        referred,
    )
