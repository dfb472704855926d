"""What the fleet page says: valves, records, news and reports."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import plural
from spool_tools.console.outputs import check_output
from spool_tools.console.terminal import progress, warn

from spool_fleet.analyses.base import REFERRED
from spool_fleet.catalogue.manifest import FILE_NAME, Manifest
from spool_fleet.page.courses import (
    Course,
    Told,
    TrendRow,
    courses_of,
    day_of,
    services_told,
    temperature_slopes,
    temperatures,
    trend_rows,
)
from spool_fleet.page.status import (
    ALARM,
    CONSPICUOUS,
    LEARNS,
    NOT_KNOWN,
    SILENT,
    WARNING,
    WHOLE,
    Light,
    date,
    light_of,
    patience,
)
from spool_fleet.tables.query import ask
from spool_fleet.trends.comparison import MONTH
from spool_fleet.trends.judgement import LEARNING, MACHINE, UNKNOWN
from spool_fleet.trends.observations import COULOMB, DAY, STIFFNESS, VISCOUS, observed_valves

Key = tuple[str, str]
#: Bags, events and troubles of each valve that are listed at most: the page of 200 valves stays small, and
#: the tables have all.
NEWEST_BAGS, NEWEST_EVENTS, NEWEST_TROUBLES = 6, 5, 5
#: Columns of parameters in the table of a valve's bags.
SHOWN = (REFERRED, VISCOUS, COULOMB, STIFFNESS, "nrmse")
#: Days: the usual pause of a valve is that which so large a share of its pauses does not exceed; weekends
#: and single bags left out are usual.
USUAL_SHARE = 0.9

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

#: Services and silent valves of the last month that are named one by one at most.
MOST_NAMED = 10

#: Folder of the reports, beside the page.
FOLDER = "fleet_reports"


@dataclass(frozen=True, slots=True)
class ValveContent:
    """Content about one valve.

    Attributes:
        machine, valve: the identity; ``anchor``: where its section is on the page.
        light: its state.
        trends: of its parameters.
        courses: of its parameters, by name.
        temperature: days and oil temperature, deg C.
        records: its bags and events.
        services: what was done to it.
        quiet: days from its newest usable bag to the fleet's.
        overdue: days of these that are more than usual; positive where it is silent.
    """

    machine: str
    valve: str
    anchor: str
    light: Light
    trends: tuple[TrendRow, ...]
    courses: dict[str, Course]
    temperature: tuple[NDArray[np.float64], NDArray[np.float64]] | None
    records: Records
    services: tuple[Told, ...]
    quiet: float
    overdue: float

    @property
    def name(self) -> str:
        """Machine and valve."""
        return f"{self.machine} {self.valve}"

    @property
    def silent(self) -> bool:
        """Whether it should have had a bag since."""
        return self.overdue > 0.0

    @property
    def conspicuous(self) -> bool:
        """Whether a change was found in it."""
        return self.light in CONSPICUOUS

    @property
    def open_questions(self) -> list[TrendRow]:
        """Trends that cannot be judged, or not yet."""
        return [one for one in self.trends if one.state in (LEARNING, UNKNOWN)]


@dataclass(frozen=True, slots=True)
class PageContent:
    """Content of the page of the fleet in ``store``.

    Attributes:
        first, newest: of the usable bags; ``None`` where there is none.
        bags, usable: how many are in the catalogue, and can be analysed.
        valves: by machine and name.
        services: that were told.
    """

    store: Path
    first: datetime | None
    newest: datetime | None
    bags: int
    usable: int
    valves: tuple[ValveContent, ...] = field(default=())
    services: tuple[Told, ...] = field(default=())

    @property
    def summary(self) -> str:
        """One line for the terminal."""
        counts = Counter(one.light for one in self.valves)
        parts = [f"{counts[ALARM] + counts[WARNING]} changed"]
        parts += [f"{counts[WHOLE]} with their whole machine"] if counts[WHOLE] else []
        parts += [f"{counts[light]} {light.word}" for light in (SILENT, LEARNS) if counts[light]]
        return f"{plural(len(self.valves), 'valve')}: {', '.join(parts)}, {counts[NOT_KNOWN]} unknown"

    @property
    def month_ago(self) -> float:
        """Day on which the last month began, counted back from the newest bag."""
        return day_of(self.newest) - MONTH

    @property
    def machines(self) -> dict[str, list[ValveContent]]:
        """Valves by machine."""
        found: dict[str, list[ValveContent]] = {}
        for one in self.valves:
            found.setdefault(one.machine, []).append(one)
        return found


def page_content(store: Path) -> PageContent:
    """Return what the tables of ``store`` say of its valves; times count back from the newest bag.

    Raises:
        InputError: there are no tables in ``store``.
    """
    (head,) = ask(
        store,
        "SELECT min(start) FILTER (status = 'ok') AS first, max(start) FILTER (status = 'ok') AS newest, "
        "count(*) AS bags, count(*) FILTER (status = 'ok') AS usable FROM bags",
    ).to_pylist()
    records, trends, services = records_of(store), trend_rows(store), services_told(store)
    observed = {one.key: one for one in observed_valves(store)}
    slopes = temperature_slopes(list(observed.values()), services)
    celsius = temperatures(store)
    pauses = sorted(one.pause for one in records.values() if one.pause is not None)
    usual = pauses[len(pauses) // 2] if pauses else 0.0
    newest = head["newest"]
    valves = []
    for number, key in enumerate(sorted(records, key=lambda one: (_natural(one[0]), _natural(one[1])))):
        own, rows = records[key], trends.get(key, [])
        quiet = math.nan if own.newest is None else (newest - own.newest).total_seconds() / DAY
        overdue = quiet - patience(usual if own.pause is None else own.pause)
        valves.append(
            ValveContent(
                *key, f"valve-{number + 1}", light_of(rows, overdue > 0.0), tuple(rows),
                courses_of(observed[key], rows, services, slopes) if key in observed else {},
                celsius.get(key), own, tuple(one for one in services if one.concerns(*key)), quiet, overdue,
            )
        )  # fmt: skip
    return PageContent(store, head["first"], newest, head["bags"], head["usable"], tuple(valves), services)


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


@dataclass(frozen=True, slots=True)
class Change:
    """Change of one valve, or of several of a machine together, of which ``trend`` is the middle one."""

    valves: tuple[ValveContent, ...]
    trend: TrendRow

    @property
    def noticed(self) -> float:
        """Day on which it could be seen first; where that is not known, when it began."""
        return self.trend.noticed if math.isfinite(self.trend.noticed) else self.trend.since


@dataclass(frozen=True, slots=True)
class News:
    """News of the month since the day ``since``; ``older`` changes were seen before and still stand."""

    since: float
    changes: tuple[Change, ...]
    older: tuple[Change, ...]
    lines: tuple[str, ...]


def news_of(content: PageContent) -> News:
    """Return what the last month brought."""
    since = content.month_ago
    changes = sorted(_changes(content), key=lambda one: -one.trend.share_of_limit)
    lines = [] if content.newest is None else _counts(content, content.newest)
    silent = [one for one in content.valves if one.silent and one.overdue <= MONTH]
    lines += [
        f"{one.name} fell silent: no usable bag for {one.quiet:.0f} days." for one in silent[:MOST_NAMED]
    ]
    if len(silent) > MOST_NAMED:
        lines.append(f"{plural(len(silent) - MOST_NAMED, 'other valve')} fell silent as well.")
    recent = [one for one in content.services if one.day >= since]
    for one in recent[-MOST_NAMED:]:
        whose = " ".join(filter(None, (one.machine, one.valve))) or "all machines"
        said = f" ({one.comment})" if one.comment else ""
        lines.append(f"{whose}: {one.kind.replace('_', ' ')} on {date(one.day)}{said}.")
    return News(
        since,
        tuple(one for one in changes if one.noticed >= since),
        tuple(one for one in changes if not one.noticed >= since),
        tuple(lines),
    )


def write_reports(
    content: PageContent, out: Path, number: int, params_file: Path | None = None
) -> dict[str, str]:
    """Write the replay reports of the ``number`` newest bags of each conspicuous valve of the page ``out``.

    What is not there any more or cannot be replayed is told and left out. A valve has as many reports as
    bags in its table at most.

    Returns:
        the report of each bag, by the bag's path, relative to the folder of the page.
    """
    from spool_tools.operations.record_replay import replay_bag  # noqa: PLC0415 - slow to load

    names = {
        row.bag: report_name(f"{valve.machine} {valve.valve}", row.bag, row.start)
        for valve in content.valves
        if valve.conspicuous
        for row in valve.records.newest_bags[:number]
    }
    files = _valve_files(content.store, list(names))
    made: dict[str, str] = {}
    folder = out.absolute().parent / FOLDER
    with progress("writing reports", len(names)) as advance:
        for bag, name in names.items():
            advance(1)
            path = Path(bag)
            if not path.exists():
                warn(f"{bag}: it is not there any more, so there is no report of it")
                continue
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if not _kept(folder / name):
                    replay_bag(path, files.get(bag, []), params_file=params_file, report=folder / name)
            except InputError as error:
                warn(f"{bag}: no report of it: {error}")
                continue
            except OSError as error:
                warn(f"{folder}: {error.strerror}: no reports beside the page")
                break
            made[bag] = f"{FOLDER}/{name}"
    return made


def report_name(valve: str, bag: str, start: datetime) -> str:
    """Return a file name of plain letters that is another one for every bag."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", valve).strip("_")[:60]
    return f"{plain or 'valve'}_{start:%Y-%m-%d}_{hashlib.sha256(bag.encode()).hexdigest()[:8]}.html"


def _natural(text: str) -> tuple[tuple[int, str], ...]:
    """Return what sorts ``valve_10`` behind ``valve_2``."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+|[0-9]+", text)
    return tuple(
        (int(part), "") if part.isascii() and part.isdigit() and len(part) <= 18 else (-1, part)
        for part in parts
    )


def _rows(store: Path, query: str) -> Iterable[dict[str, Any]]:
    return ask(store, query).to_pylist()  # type: ignore[no-any-return]


def _changes(content: PageContent) -> list[Change]:
    single: list[Change] = []
    shared: dict[tuple[str, str], list[tuple[ValveContent, TrendRow]]] = {}
    for valve in content.valves:
        for trend in valve.trends:
            if trend.state == MACHINE:
                shared.setdefault((trend.machine, trend.parameter), []).append((valve, trend))
            elif trend.changed:
                single.append(Change((valve,), trend))
    for same in shared.values():
        middle = sorted((trend for _, trend in same), key=lambda one: one.change)[len(same) // 2]
        single.append(Change(tuple(valve for valve, _ in same), middle))
    return single


def _counts(content: PageContent, newest: datetime) -> list[str]:
    """Return lines on bags and events of the last month."""
    begin = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(days=content.month_ago)
    recent = (
        f"start > TIMESTAMPTZ '{begin:%Y-%m-%d %H:%M:%S}+00' AND start <= TIMESTAMPTZ '{newest.isoformat()}'"
    )
    (row,) = ask(
        content.store,
        f"SELECT (SELECT count(*) FROM bags WHERE {recent}) AS bags, "
        f"(SELECT count(*) FROM bags WHERE {recent} AND status = 'damaged') AS damaged, "
        f"(SELECT count(*) FROM analyses WHERE {recent} AND status <> 'ok') AS failed, "
        f"(SELECT count(*) FROM events WHERE {recent} AND state = 'raised') AS raised, "
        "(SELECT count(DISTINCT (machine, valve)) FROM events "
        f"WHERE {recent} AND state = 'raised') AS valves",
    ).to_pylist()
    lines = [
        f"{plural(row['bags'], 'bag')}; {row['damaged']} of them damaged, "
        f"{plural(row['failed'], 'analysis').replace('analysiss', 'analyses')} failed."
    ]
    if row["raised"]:
        lines.append(
            f"The monitor raised {plural(row['raised'], 'event')} on {plural(row['valves'], 'valve')}."
        )
    return lines


def _kept(file: Path) -> bool:
    """Return whether a report that is there already stays, since it is not to be replaced (``--force``)."""
    try:
        check_output(file, "--out")
    except InputError:
        if file.is_file() and not file.is_symlink():
            return True
        raise
    return False


def _valve_files(store: Path, bags: list[str]) -> dict[str, list[str]]:
    """Return the valve files that `./spool fleet add` was given for ``bags``; the tables do not have them."""
    if not (store / FILE_NAME).is_file():
        return {}
    manifest = Manifest(store)
    try:
        return {
            bag: [f"{one.namespace}={one.valve_file}" for one in manifest.of(bag) if one.valve_file]
            for bag in bags
        }
    finally:
        manifest.close()
