"""Observations of a fleet: each valve's parameters from bag to bag, as logarithms with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spool_fleet.analyses.base import REFERRED
from spool_fleet.tables.query import ask

Array = NDArray[np.float64]

VISCOUS, COULOMB, STIFFNESS = "viscous_coefficient", "coulomb_force", "spring_stiffness"
#: Parameters that wear, dirt and springs change.
PARAMETERS = (VISCOUS, COULOMB, STIFFNESS)
DAY = 86_400.0
#: Relative standard deviation above which a bag says nothing of a parameter, as in the monitor.
UNCERTAIN = 0.35


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
    """Observed valve: its series by parameter."""

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
