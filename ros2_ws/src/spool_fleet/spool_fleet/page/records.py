"""Records of a valve for the fleet's page: its newest bags, events, what could not be used."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from spool_fleet.analyses.base import REFERRED
from spool_fleet.tables.query import ask
from spool_fleet.trends.observations import COULOMB, STIFFNESS, VISCOUS

Key = tuple[str, str]
#: Bags, events and troubles of each valve that are listed at most: the page of 200 valves stays small, and
#: the tables have all.
NEWEST_BAGS, NEWEST_EVENTS, NEWEST_TROUBLES = 6, 5, 5
#: Columns of parameters in the table of a valve's bags.
SHOWN = (REFERRED, VISCOUS, COULOMB, STIFFNESS, "nrmse")
#: Days: the usual pause of a valve is that which so large a share of its pauses does not exceed; weekends
#: and single bags left out are usual.
USUAL_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class BagRow:
    """Bag of a valve: value and standard deviation of its parameters by name, and how many alarms it has."""

    bag: str
    start: datetime
    duration: float
    temperature: float | None
    parameters: dict[str, tuple[float, float | None, str]]
    raised: int


@dataclass(frozen=True, slots=True)
class EventRow:
    """Event that the monitor raised in a bag."""

    bag: str
    start: datetime
    kind: str
    severity: str
    message: str


@dataclass(frozen=True, slots=True)
class Trouble:
    """Bag that is damaged or there twice, or an analysis that failed."""

    bag: str
    start: datetime
    what: str
    reason: str


@dataclass(slots=True)
class Records:
    """Records of one valve: counts of all, the newest of each kind."""

    bags: int = 0
    usable: int = 0
    raised: int = 0
    troubles: int = 0
    newest: datetime | None = None
    pause: float | None = None
    newest_bags: list[BagRow] = field(default_factory=list)
    newest_events: list[EventRow] = field(default_factory=list)
    newest_troubles: list[Trouble] = field(default_factory=list)


def records_of(store: Path) -> dict[Key, Records]:
    """Return the records of each valve; one of which there are but copies of others' bags is none."""
    found: dict[Key, Records] = {}
    for row in ask(store, _COUNTS).to_pylist():
        found[row["machine"], row["valve"]] = Records(
            row["bags"], row["usable"], newest=row["newest"], pause=row["pause"]
        )
    values: dict[tuple[str, Key], dict[str, tuple[float, float | None, str]]] = {}
    for row in _rows(store, _PARAMETERS):
        whose = (row["bag"], (row["machine"], row["valve"]))
        values.setdefault(whose, {})[row["name"]] = (row["value"], row["std"], row["unit"] or "")
    for row in _rows(store, _BAGS):
        key = (row["machine"], row["valve"])
        own = values.get((row["bag"], key), {})
        if key in found:
            found[key].newest_bags.append(
                BagRow(row["bag"], row["start"], row["duration_s"] or 0.0, row["oil_temperature_C"], own,
                       row["raised"])
            )  # fmt: skip
    for row in _rows(store, _EVENTS):
        one = found.get((row["machine"], row["valve"]))
        if one is not None:
            one.raised = row["count"]
            one.newest_events.append(
                EventRow(row["bag"], row["start"], row["kind"], row["severity"] or "", row["message"] or "")
            )
    for row in _rows(store, _TROUBLES):
        one = found.get((row["machine"], row["valve"]))
        if one is not None:
            one.troubles = row["count"]
            one.newest_troubles.append(Trouble(row["bag"], row["start"], row["what"], row["reason"] or ""))
    return found


def _rows(store: Path, query: str) -> Iterable[dict[str, Any]]:
    return ask(store, query).to_pylist()  # type: ignore[no-any-return]


_COUNTS = f"""
WITH days AS (SELECT DISTINCT machine, valve, start::DATE AS day FROM bags WHERE status = 'ok'),
pauses AS (
    SELECT machine, valve, day - lag(day) OVER (PARTITION BY machine, valve ORDER BY day) AS pause FROM days
),
usual AS (SELECT machine, valve, quantile_cont(pause, {USUAL_SHARE}) AS pause FROM pauses GROUP BY ALL)
SELECT b.machine, b.valve, count(*) AS bags, count(*) FILTER (b.status = 'ok') AS usable,
    max(b.start) FILTER (b.status = 'ok') AS newest, any_value(u.pause)::DOUBLE AS pause
FROM bags b LEFT JOIN usual u ON u.machine = b.machine AND u.valve = b.valve
GROUP BY b.machine, b.valve HAVING count(*) FILTER (b.status <> 'duplicate') > 0
"""
_NUMBERED = "row_number() OVER (PARTITION BY machine, valve ORDER BY start DESC, bag)"
_NEWEST = f"SELECT * FROM bags WHERE status = 'ok' QUALIFY {_NUMBERED} <= {NEWEST_BAGS}"
_BAGS = f"""
SELECT n.*, (
    SELECT count(*) FROM events e WHERE e.bag = n.bag AND e.valve = n.valve AND e.state = 'raised'
) AS raised FROM ({_NEWEST}) n ORDER BY start DESC, bag
"""
# A fit counts before the monitor's estimate, as in the trends.
_PARAMETERS = f"""
SELECT p.bag, p.machine, p.valve, p.name, p.value, p.std, p.unit FROM parameters p
JOIN ({_NEWEST}) n ON n.bag = p.bag AND n.valve = p.valve
WHERE p.name IN ({", ".join(f"'{name}'" for name in SHOWN)}) AND p.analysis IN ('fit', 'monitor')
    AND p.value IS NOT NULL
QUALIFY row_number() OVER (PARTITION BY p.bag, p.valve, p.name ORDER BY p.analysis) = 1
"""
_EVENTS = f"""
SELECT bag, machine, valve, start, kind, severity, message,
    count(*) OVER (PARTITION BY machine, valve) AS count
FROM events WHERE state = 'raised'
QUALIFY row_number() OVER (PARTITION BY machine, valve ORDER BY start DESC, t_s DESC) <= {NEWEST_EVENTS}
ORDER BY start DESC, t_s DESC
"""
_TROUBLES = f"""
SELECT *, count(*) OVER (PARTITION BY machine, valve) AS count FROM (
    SELECT bag, machine, valve, start, status AS what, reason FROM bags WHERE status <> 'ok' UNION ALL
    SELECT bag, machine, valve, start, analysis || ' failed', reason FROM analyses WHERE status <> 'ok'
)
QUALIFY {_NUMBERED} <= {NEWEST_TROUBLES} ORDER BY start DESC, bag
"""
