"""Rows of the table of trends, typed: numbers that are not known are NaN, times days since 1970."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from spool_fleet.tables.query import ask
from spool_fleet.trends.judgement import CHANGED, LIMITS, MACHINE
from spool_fleet.trends.observations import COULOMB, DAY, PARAMETERS, STIFFNESS, VISCOUS

#: What people call the parameters.
NAMES = {VISCOUS: "viscous coefficient", COULOMB: "Coulomb force", STIFFNESS: "spring stiffness"}


@dataclass(frozen=True, slots=True)
class TrendRow:
    """Row of the table ``trends``; see there."""

    machine: str
    valve: str
    parameter: str
    unit: str
    bags: int
    state: str
    cause: str
    reason: str
    latest: float
    since: float
    noticed: float
    baseline: float
    baseline_std: float
    change: float
    change_std: float
    rate: float
    rate_std: float
    threshold: float
    months_to_threshold: float
    months_earliest: float
    months_latest: float

    @property
    def changed(self) -> bool:
        """Whether a change was found, of the valve or of its machine."""
        return self.state in (CHANGED, MACHINE)

    @property
    def share_of_limit(self) -> float:
        """Change in shares of that at which the monitor warns; NaN where nothing changed."""
        return self.change / self.threshold if self.changed else math.nan

    @property
    def limit(self) -> float:
        """Relative change at which the monitor warns, without sign; NaN where the baseline is not known."""
        one = LIMITS[self.parameter]
        return one.default if one.unit == "1" else one.default / self.baseline


def trend_rows(store: Path) -> dict[tuple[str, str], list[TrendRow]]:
    """Return the trends by valve, in the order of ``PARAMETERS``."""
    found: dict[tuple[str, str], list[TrendRow]] = {}
    for row in ask(store, "trends").to_pylist():
        if row["parameter"] not in PARAMETERS:
            continue
        one = TrendRow(
            row["machine"], row["valve"], row["parameter"], row["unit"] or "", row["bags"] or 0,
            row["state"], row["cause"] or "", row["reason"] or "",
            *(day_of(row[name]) for name in ("latest", "since", "noticed")),
            *(
                _number(row[name])
                for name in (
                    "baseline", "baseline_std", "change", "change_std", "rate_per_month",
                    "rate_per_month_std", "threshold", "months_to_threshold", "months_earliest",
                    "months_latest",
                )
            ),
        )  # fmt: skip
        found.setdefault((one.machine, one.valve), []).append(one)
    for trends in found.values():
        trends.sort(key=lambda one: PARAMETERS.index(one.parameter))
    return found


def day_of(moment: datetime | None) -> float:
    """Return ``moment`` in days since 1970."""
    return math.nan if moment is None else moment.timestamp() / DAY


def _number(value: float | None) -> float:
    return math.nan if value is None else value
