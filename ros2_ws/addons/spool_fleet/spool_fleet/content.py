"""What the fleet page says: valves, records, news and reports."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.events.language import ENGLISH, EventText
from spool_core.text import plural
from spool_core.uncertainty import interval, number
from spool_monitor.detectors import friction_drift, spring_change
from spool_report.outputs import check_output
from spool_report.terminal import progress, warn

from spool_fleet.comparison import MONTH
from spool_fleet.courses import (
    NAMES,
    Course,
    courses_of,
    day_of,
    services_told,
    temperature_slopes,
    temperatures,
    trend_rows,
)
from spool_fleet.judgement import CHANGED, LEARNING, MACHINE, UNKNOWN, Trend
from spool_fleet.manifest import DAY, FILE_NAME, Manifest, Service
from spool_fleet.observations import COULOMB, STIFFNESS, VISCOUS, observed_valves
from spool_fleet.parquet import REFERRED
from spool_fleet.query import ask

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

#: Months: a change that may reach the monitor's limit sooner is to be acted on now, since a spool has to be
#: ordered and a stop of the machine planned, which takes about a quarter of a year.
SOON = 3.0
#: Usual pauses of a valve, and days, after which it is silent: a holiday of two weeks is no silence.
PAUSES, LEAST_SILENCE = 3.0, 14.0


@dataclass(frozen=True, slots=True)
class Light:
    """``name`` in the page's styles; ``mark`` and ``word`` say it without colour."""

    name: str
    mark: str
    word: str
    meaning: str


ALARM = Light(
    "alarm", "▲", "act now",
    "a parameter changed and is past the limit at which the monitor of the running valve warns, or may be "
    f"there within {SOON:g} months (early end of the 95 % interval)",
)  # fmt: skip
WARNING = Light("warning", "◆", "changed", "a parameter changed, the monitor's limit is not near")
SILENT = Light(
    "silent", "∅", "silent",
    f"no usable bag for {PAUSES:g} times the valve's usual pause, at least {LEAST_SILENCE:g} days",
)  # fmt: skip
WHOLE = Light(
    "whole", "■", "whole machine",
    "the valves of the machine changed together: check what they share, first the oil",
)  # fmt: skip
NOT_KNOWN = Light("unknown", "?", "unknown", "a parameter cannot be judged; the valve's section explains why")
LEARNS = Light("learning", "…", "learning", "too few weeks with bags for a judgement")
GOOD = Light("good", "●", "ok", "all three parameters are judged, none changed")
#: The worst first: a valve of which several are true shows the first of them.
LIGHTS = (ALARM, WARNING, SILENT, WHOLE, NOT_KNOWN, LEARNS, GOOD)
#: Those of which reports are made, and which are opened for print.
CONSPICUOUS = (ALARM, WARNING, WHOLE)

#: Months below which days are shown: half a month rounded to two digits says too little or too much.
SHORT = 1.0
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


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
    trends: tuple[Trend, ...]
    courses: dict[str, Course]
    temperature: tuple[NDArray[np.float64], NDArray[np.float64]] | None
    records: Records
    services: tuple[Service, ...]
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
    def open_questions(self) -> list[Trend]:
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
    services: tuple[Service, ...] = field(default=())

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
    for place, key in enumerate(sorted(records, key=lambda one: (_natural(one[0]), _natural(one[1])))):
        own, rows = records[key], trends.get(key, [])
        quiet = math.nan if own.newest is None else (newest - own.newest).total_seconds() / DAY
        overdue = quiet - patience(usual if own.pause is None else own.pause)
        valves.append(
            ValveContent(
                *key, f"valve-{place + 1}", light_of(rows, overdue > 0.0), tuple(rows),
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
    temperature: float | None
    parameters: dict[str, tuple[float, float | None, str]]
    raised: int


@dataclass(frozen=True, slots=True)
class EventRow:
    """Event that the monitor raised in a bag."""

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
    for row in ask(store, _PARAMETERS).to_pylist():
        whose = (row["bag"], (row["machine"], row["valve"]))
        values.setdefault(whose, {})[row["name"]] = (row["value"], row["std"], row["unit"] or "")
    for row in ask(store, _BAGS).to_pylist():
        key = (row["machine"], row["valve"])
        own = values.get((row["bag"], key), {})
        if key in found:
            found[key].newest_bags.append(
                BagRow(row["bag"], row["start"], row["oil_temperature_C"], own, row["raised"])
            )
    for row in ask(store, _EVENTS).to_pylist():
        one = found.get((row["machine"], row["valve"]))
        if one is not None:
            one.raised = row["count"]
            one.newest_events.append(
                EventRow(row["start"], row["kind"], row["severity"] or "", row["message"] or "")
            )
    for row in ask(store, _TROUBLES).to_pylist():
        one = found.get((row["machine"], row["valve"]))
        if one is not None:
            one.troubles = row["count"]
            one.newest_troubles.append(Trouble(row["bag"], row["start"], row["what"], row["reason"] or ""))
    return found


@dataclass(frozen=True, slots=True)
class Change:
    """Change of one valve, or of several of a machine together, of which ``trend`` is the middle one."""

    valves: tuple[ValveContent, ...]
    trend: Trend

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
    single: list[Change] = []
    shared: dict[tuple[str, str], list[tuple[ValveContent, Trend]]] = {}
    for valve in content.valves:
        for trend in valve.trends:
            if trend.state == MACHINE:
                shared.setdefault((trend.machine, trend.parameter), []).append((valve, trend))
            elif trend.changed:
                single.append(Change((valve,), trend))
    for same in shared.values():
        middle = sorted((trend for _, trend in same), key=lambda one: one.change)[len(same) // 2]
        single.append(Change(tuple(valve for valve, _ in same), middle))
    changes = sorted(single, key=lambda one: -one.trend.share_of_limit)
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

    What is not there any more or cannot be replayed is reported and left out. A valve has as many reports as
    bags in its table at most.

    Returns:
        the report of each bag, by the bag's path, relative to the folder of the page.
    """
    from spool_report.requests import ReplayRequest  # noqa: PLC0415 - slow to load, as below
    from spool_report.runs.record_replay import replay_bag  # noqa: PLC0415

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
                warn(f"{bag}: the bag no longer exists, so it has no report")
                continue
            try:
                folder.mkdir(parents=True, exist_ok=True)
                if not _kept(folder / name):
                    valve = files.get(bag, [])
                    request = ReplayRequest(record=path, valve=valve, params_file=params_file)
                    replay_bag(request, folder / name)
            except InputError as error:
                warn(f"{bag}: cannot write its report: {error}")
                continue
            except OSError as error:
                warn(f"{folder}: {error.strerror}: the page has no reports")
                break
            made[bag] = f"{FOLDER}/{name}"
    return made


def report_name(valve: str, bag: str, start: datetime) -> str:
    """Return a file name of plain letters that is another one for every bag."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", valve).strip("_")[:60]
    return f"{plain or 'valve'}_{start:%Y-%m-%d}_{hashlib.sha256(bag.encode()).hexdigest()[:8]}.html"


def light_of(trends: Sequence[Trend], silent: bool) -> Light:
    """Return the light of a valve with ``trends``; without any it is unknown."""
    states = {one.state for one in trends}
    if any(one.state == CHANGED and urgent(one) for one in trends):
        return ALARM
    if CHANGED in states:
        return WARNING
    if silent:
        return SILENT
    for state, light in ((MACHINE, WHOLE), (UNKNOWN, NOT_KNOWN), (LEARNING, LEARNS)):
        if state in states:
            return light
    return GOOD if states else NOT_KNOWN


def urgent(trend: Trend) -> bool:
    """Return whether a change is past the monitor's limit or may soon be."""
    expected, earliest, _ = trend.months_left()
    soonest = earliest if math.isfinite(earliest) else expected
    return trend.share_of_limit >= 1.0 or soonest <= SOON


def patience(pause: float) -> float:
    """Return the days after which a valve with a usual ``pause`` is silent."""
    return max(PAUSES * pause, LEAST_SILENCE)


def change_sentence(trend: Trend) -> str:
    """Return what changed, by how much (95 % interval), since when and how fast."""
    verb = "rose" if trend.change > 0.0 else "fell"
    size = interval(100.0 * abs(trend.change), 100.0 * trend.change_std)
    name = NAMES[trend.parameter]
    text = f"{name[0].upper()}{name[1:]} {verb} by {size} % since about {date(trend.since)}"
    if math.isfinite(trend.rate):
        text += f", {interval(100.0 * abs(trend.rate), 100.0 * trend.rate_std)} % a month"
    return text


def limit_sentence(trend: Trend) -> str:
    """Return how near the monitor's limit is, and when it is reached."""
    limit = f"the limit of the running valve's monitor ({percent(trend.threshold)})"
    if trend.share_of_limit >= 1.0:
        return f"past {limit}"
    if math.isnan(trend.months_left()[0]):
        return f"{percent(trend.share_of_limit)} of the way to {limit}; it does not grow"
    return f"at {limit} in {time_left(trend)}"


def time_left(trend: Trend) -> str:
    """Return how long until the monitor's limit is reached, with its interval; short times in days."""
    if trend.share_of_limit >= 1.0:
        return "past it"
    months = trend.months_left()
    if math.isnan(months[0]):
        return "does not grow"
    short = months[0] < SHORT

    def text(months: float) -> str:
        if math.isnan(months):
            return "open"
        return f"{math.ceil(MONTH * months)}" if short else number(months, 2)

    left, earliest, latest = map(text, months)
    return f"{left} {'days' if short else 'months'} ({earliest} to {latest})"


def cause_of(trend: Trend) -> EventText:
    """Return the cause as the monitor describes it, with what to do."""
    if trend.parameter == STIFFNESS:
        return ENGLISH.event(spring_change.KIND.cause("softer" if trend.change < 0.0 else "stiffer").code)
    return ENGLISH.event(friction_drift.KIND.cause(trend.cause or "unknown").code)


def cause_name(trend: Trend) -> str:
    """Return the cause in words."""
    if trend.parameter == STIFFNESS and trend.state != MACHINE:
        return "a spring that is softer" if trend.change < 0.0 else "springs that are stiffer"
    names = {"oil_contamination": "contaminated oil", "oil_viscosity": "the oil's viscosity"}
    return names.get(trend.cause, trend.cause.replace("_", " ")) or "unknown"


def date(day: float) -> str:
    """Return the date of ``day`` since 1970."""
    return (_EPOCH + timedelta(days=day)).strftime("%Y-%m-%d") if math.isfinite(day) else "unknown"


def percent(share: float) -> str:
    """Return ``share`` in per cent without sign, two digits."""
    return f"{number(100.0 * abs(share), 2)} %"


def _natural(text: str) -> tuple[tuple[int, str], ...]:
    """Return what sorts ``valve_10`` behind ``valve_2``."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+|[0-9]+", text)
    return tuple(
        (int(part), "") if part.isascii() and part.isdigit() and len(part) <= 18 else (-1, part)
        for part in parts
    )


def _counts(content: PageContent, newest: datetime) -> list[str]:
    """Return lines on bags and events of the last month."""
    begin = _EPOCH + timedelta(days=content.month_ago)
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
        f"{row['failed']} {'analysis' if row['failed'] == 1 else 'analyses'} failed."
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
    with closing(Manifest(store)) as manifest:
        return {
            bag: [f"{one.namespace}={one.valve_file}" for one in manifest.of(bag) if one.valve_file]
            for bag in bags
        }
