"""Journals of the monitors: `./spool alarm history`, figures of the alarm system, a month as a page."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from itertools import pairwise
from pathlib import Path

from spool_core.errors import InputError
from spool_core.events.language import ENGLISH
from spool_core.events.sentences import language_of, title
from spool_core.text import plural
from spool_core.uncertainty import number
from spool_monitor import alarm_statistics
from spool_monitor.journal import COLUMNS, JournalEntry, cells, entries_in, iso
from spool_monitor.trend import DAY, HOUR, Span, TrendStore
from spool_report import page as html
from spool_report.outputs import STANDARD_OUTPUT, check_output, write_file, write_json
from spool_report.terminal import Table, wide_console

from spool_tools.operations.valve_trend import kept_files, moment

#: Figures for people: title and unit by name.
FIGURES = {
    "per_day": ("alarms per day", ""),
    "per_hour": ("alarms per hour, on average", ""),
    "peak": ("most alarms in 10 min", ""),
    "flood_share": ("time in flood", " %"),
    "frequent_share": ("share of the ten most frequent alarms", " %"),
    "chattering": ("chattering alarms", ""),
    "stale": ("alarms active for a day or longer", ""),
}


def show_history(
    valve: str | None, state_folder: Path | None, since: str | None, search: str, out: Path | None, code: str
) -> None:
    """Show the journal of ``valve``, or of all valves, oldest first; write it as CSV to ``out``.

    Args:
        valve: namespace; ``None``: all.
        state_folder: of the monitors; ``None``: the default one.
        since: how long ago, or a time; ``None``: all.
        search: words that an entry must hold, in any column.
        out: CSV file; ``-``: standard output.
        code: language of the headlines.

    Raises:
        InputError: there is no journal, or an option is wrong.

    """
    language = language_of(code)
    begin = moment(since) * 1_000_000_000
    words = search.casefold().split()
    files = kept_files(state_folder, valve, "journals")
    entries = [(name, one) for name, path in files.items() for one in entries_in(path, begin)]
    rows = [
        row
        for name, one in sorted(entries, key=lambda pair: pair[1].stamp)
        for row in [cells(name, one, language)]
        if all(word in " ".join(map(str, row)).casefold() for word in words)
    ]
    if out is not None:
        content = io.StringIO()
        csv.writer(content, lineterminator="\n").writerows([COLUMNS, *rows])
        write_file(out, content.getvalue(), "--csv")
        if out == STANDARD_OUTPUT:
            return
    if not rows:
        print("no entry" + (f" with {search!r}" if search else "") + (f" since {since}" if since else ""))
        return
    shown = []
    for row in rows:
        one = dict(zip(COLUMNS, row, strict=True))
        time = str(one["time"]).replace("T", " ").removesuffix("Z")
        text = f"{one['text']} ({one['comment']})".strip() if one["comment"] else one["text"]
        alarm = f"{one['code'] or ''} {one['alarm']}".strip()
        shown.append((time, one["valve"], one["action"], alarm, one["who"], text))
    columns = ("time (UTC)", "valve", "action", "alarm", "who", "text")
    Table(columns, shown).show(wide_console(160))


def show_statistics(
    valve: str | None, state_folder: Path | None, since: str | None, limits: Sequence[str], json: Path | None
) -> int:
    """Show the figures of the alarm system; return 1 where one is beyond the site's limits.

    Args:
        valve: namespace; ``None``: all valves, as one operator has them.
        state_folder: of the monitors; ``None``: the default one.
        since: how long ago, or a time; ``None``: since the first entry.
        limits: of the site, each ``NAME=VALUE``.
        json: file for the figures.

    Raises:
        InputError: there is no journal, it is empty, or an option is wrong.

    """
    allowed = alarm_statistics.AlarmLimits().changed(limits)
    check_output(json, "--json")
    journals = {name: entries_in(path) for name, path in kept_files(state_folder, valve, "journals").items()}
    stamps = [one.stamp for entries in journals.values() for one in entries]
    if not stamps:
        raise InputError("statistics: the journals are empty: no alarm was raised yet")
    until = round(datetime.now(timezone.utc).timestamp() * 1e9)
    begin = moment(since) * 1_000_000_000 or min(stamps)
    if begin >= until:
        raise InputError(f"--since {since}: it lies in the future")
    found = alarm_statistics.statistics(journals, begin, until)
    beyond = found.beyond(allowed)
    if json is not None:
        write_json(
            json,
            {
                **asdict(found),
                "chattering": [{"valve": valve, "alarm": alarm} for valve, alarm in found.chattering],
                "stale": [{"valve": valve, "alarm": alarm} for valve, alarm in found.stale],
                "limits": asdict(allowed),
                "beyond": list(beyond),
            },
        )
    _show(found, allowed, len(journals))
    return 1 if beyond else 0


def figure_table(found: alarm_statistics.AlarmStatistics, limits: alarm_statistics.AlarmLimits) -> Table:
    """Return a row for each figure of the alarm system, with the site's limit."""
    rows = [
        (title, value + unit, limit + unit, "" if kept else "beyond the limit")
        for name, value, limit, kept in alarm_statistics.figures(found, limits)
        for title, unit in (FIGURES[name],)
    ]
    return Table(("figure (ISA-18.2)", "value", "limit", ""), rows, ("value", "limit"), "Alarm system")


def _show(found: alarm_statistics.AlarmStatistics, limits: alarm_statistics.AlarmLimits, valves: int) -> None:
    console = wide_console(120, markup=False)
    begin, end = (f"{iso(stamp)[:16].replace('T', ' ')}" for stamp in (found.since, found.until))
    of = f"{plural(found.count, 'alarm')} of {plural(valves, 'valve')}"
    console.print(f"{of} from {begin} to {end} UTC", soft_wrap=True)
    figure_table(found, limits).show(console)
    console.print(
        f"An alarm flood begins at {alarm_statistics.FLOOD_BEGINS} alarms in 10 min "
        f"and ends below {alarm_statistics.FLOOD_ENDS}. "
        "Limits: ISA-18.2 for one operator; change one with --limit NAME=VALUE.",
        soft_wrap=True,
    )
    if found.frequent:
        rows = [
            (one.alarm, one.valve, one.code, one.count, f"{100 * one.share:.0f} %") for one in found.frequent
        ]
        Table(("most frequent", "valve", "number", "count", "share"), rows).show(console)
    for heading, pairs in (("chattering", found.chattering), ("active for a day or longer", found.stale)):
        if pairs:
            console.print(
                f"{heading}: {', '.join(f'{valve} {alarm}' for valve, alarm in pairs)}", soft_wrap=True
            )


#: Parameters of a valve's line: name, title, unit.
PARAMETERS = (
    ("coulomb_force", "Coulomb force", "N"),
    ("viscous_coefficient", "viscous coefficient", "N s/m"),
    ("natural_frequency", "natural frequency", "Hz"),
)
#: Share of the month in which a valve's data count as complete.
COMPLETE = 0.995
_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Course:
    """Course of a parameter over the month.

    Attributes:
        text: mean of the first and of the last day with data, and the change.
        path, band: SVG paths of daily means and of the span from minimum to maximum, 100 x 20.
    """

    text: str
    path: str = ""
    band: str = ""


@dataclass(frozen=True, slots=True)
class ValveLine:
    """Line of one valve.

    Attributes:
        name: within its machine.
        count: alarms that were announced.
        worst: the worst one: date, title and advice.
        urgency: of the worst one, to sort by: severity, urgency, number.
        open: alarms that stand at the end of the month.
        courses: of each of :data:`PARAMETERS`.
        travel: way of the spool in the month, m.
        data: share of the hours with estimates.
        share: the same as a number.
    """

    name: str
    count: int
    worst: str
    urgency: tuple[bool, int, int]
    open: str
    courses: tuple[Course, ...]
    travel: str
    data: str
    share: float


@dataclass(frozen=True, slots=True)
class Machine:
    """Page of one machine: its title, one sentence, and its valves, those with open alarms first."""

    title: str
    sentence: str
    valves: tuple[ValveLine, ...]


def write_month(month: str, machine: str | None, state_folder: Path | None, out: Path) -> None:
    """Write the report of a month as one HTML page that prints on A4 and needs no network.

    Args:
        month: ``YYYY-MM`` (UTC); empty: the last whole month.
        machine: first part of the namespaces; ``None``: every machine.
        state_folder: of the monitors; ``None``: the default one.
        out: file.

    Raises:
        InputError: the month is written otherwise or lies ahead, or there is no such machine.

    """
    begin, end = _span(month)
    check_output(out, "--out")
    files = kept_files(state_folder, None, "journals")
    machines = sorted({_split(valve)[0] for valve in files})
    if machine is not None:
        if machine not in machines:
            raise InputError(f"--machine {machine}: there are: {', '.join(filter(None, machines)) or 'none'}")
        machines = [machine]
    journals = {valve: entries_in(path, 0, end * _SECOND) for valve, path in files.items()}
    until = min(end, int(datetime.now(timezone.utc).timestamp()))
    chosen = {valve: journals[valve] for valve in files if _split(valve)[0] in machines}
    pages = [
        _machine(
            one, {valve: files[valve] for valve in chosen if _split(valve)[0] == one}, chosen, begin, until
        )
        for one in machines
    ]
    counted = alarm_statistics.statistics(chosen, begin * _SECOND, until * _SECOND)
    label = datetime.fromtimestamp(begin, timezone.utc).strftime("%B %Y")
    sections = [
        html.paragraph(
            f"{plural(len(chosen), 'valve')} of {plural(len(pages), 'machine')}, {label} (UTC). Each course "
            "shows the mean of a day within its minimum and maximum; the numbers are the first and the last "
            "day with data."
        ),
        html.rendered(
            "month.html", machines=pages, parameters=[(name, unit) for _, name, unit in PARAMETERS]
        ),
        html.table(figure_table(counted, alarm_statistics.AlarmLimits())),
    ]
    write_file(out, html.page(f"Spool valves: {label}", sections), "--out")
    print(f"{out}: {plural(len(chosen), 'valve')}, {plural(counted.count, 'alarm')}")


def _span(month: str) -> tuple[int, int]:
    """Return begin and end of ``month``, s since 1970; without one of the last whole month."""
    now = datetime.now(timezone.utc)
    if not month:
        year, number_ = (now.year, now.month - 1) if now.month > 1 else (now.year - 1, 12)
    elif re.fullmatch(r"\d{4}-(0[1-9]|1[0-2])", month) and month >= "1970-01":
        year, number_ = int(month[:4]), int(month[5:])
    else:
        raise InputError(f"--month {month!r}: write it like {now:%Y-%m}")
    begin = datetime(year, number_, 1, tzinfo=timezone.utc)
    if begin > now:
        raise InputError(f"--month {month}: it lies ahead")
    end = datetime(year + number_ // 12, number_ % 12 + 1, 1, tzinfo=timezone.utc)
    return int(begin.timestamp()), int(end.timestamp())


def _split(valve: str) -> tuple[str, str]:
    """Return machine and name of a valve; a namespace of one part belongs to no machine."""
    machine, _, name = valve.rpartition("/")
    return machine, name


def _machine(
    name: str, files: dict[str, Path], journals: dict[str, list[JournalEntry]], begin: int, until: int
) -> Machine:
    lines = [_line(valve, path, journals[valve], begin, until) for valve, path in files.items()]
    alarmed = sum(one.count > 0 for one in lines)
    standing = [one for one in lines if one.open]
    gaps = sum(one.share < COMPLETE for one in lines)
    alarms = plural(sum(one.count for one in lines), "alarm")
    sentence = f"{alarmed} of {plural(len(lines), 'valve')} raised {alarms}"
    if standing:
        sentence += f"; open at the end: {', '.join(one.name for one in standing[:5])}"
        sentence += f" and {len(standing) - 5} more" if len(standing) > 5 else ""
    sentence += f"; {plural(gaps, 'valve')} without complete data." if gaps else "; all data are complete."
    digits = re.compile(r"\d+")  # valve_2 comes before valve_10
    ordered = sorted(
        lines,
        key=lambda one: (
            not one.open,
            *(-part for part in one.urgency),
            digits.sub(lambda found: found[0].zfill(9), one.name),
        ),
    )
    return Machine(name or "This machine", sentence, tuple(ordered))


def _line(valve: str, path: Path, entries: Sequence[JournalEntry], begin: int, until: int) -> ValveLine:
    standing: dict[str, JournalEntry] = {}
    announced: list[JournalEntry] = []
    kinds = {}
    for one in entries:
        if one.state in alarm_statistics.ACTIVE:
            standing[one.alarm] = one
        else:
            standing.pop(one.alarm, None)
        if (
            one.action == "raise"
            and one.state in alarm_statistics.ACTIVE
            and begin * _SECOND <= one.stamp < until * _SECOND
        ):
            announced.append(one)
        kinds[one.code] = one.alarm.partition("/")[0]
    worst, urgency = "", (False, 0, 0)
    if announced:
        one = max(announced, key=lambda one: (*_urgency(one), -one.stamp))
        urgency = *_urgency(one), len(announced)
        day = datetime.fromtimestamp(one.stamp // _SECOND, timezone.utc)
        advice = ENGLISH.event(one.code).advice
        worst = f"{day:%d %b}: {title(one.code, kinds[one.code], ENGLISH)}. {advice[:1].upper()}{advice[1:]}"
    store = TrendStore(path, read_only=True)
    try:
        units = store.units()
        courses = tuple(
            _course(_within(store.spans(name, DAY, begin), until), unit) for name, _, unit in PARAMETERS
        )
        hours = len(_within(store.spans(PARAMETERS[0][0], HOUR, begin), until))
        way = _within(store.spans("travel", DAY, begin), until) if "travel" in units else []
    finally:
        store.close()
    share = hours * HOUR / (until - begin)
    return ValveLine(
        name=_split(valve)[1],
        count=len(announced),
        worst=worst,
        urgency=urgency,
        open=", ".join(title(one.code, kinds[one.code], ENGLISH) for one in standing.values()),
        courses=courses,
        travel=number(way[-1].maximum - way[0].minimum, 3) if way else "",
        data=f"{100 * min(1.0, share):.0f} %",
        share=share,
    )


def _urgency(one: JournalEntry) -> tuple[bool, int]:
    """Return whether the event is an alarm, and how soon somebody has to act."""
    found = one.said
    return one.severity == "alarm", 0 if found is None else int(found.facts.urgency)


def _within(spans: Sequence[Span], until: int) -> list[Span]:
    return [one for one in spans if one.start < until]


def _course(spans: Sequence[Span], unit: str) -> Course:
    """Return the course of daily ``spans``; a gap of days breaks the line."""
    if not spans:
        return Course("no data")
    first, last = spans[0].mean, spans[-1].mean
    percent = round(100 * (last / first - 1)) if first else 0
    change = f" ({percent:+d} %)" if percent else ""
    text = f"{number(first, 3)} … {number(last, 3)} {unit}{change}"
    low, high = min(one.minimum for one in spans), max(one.maximum for one in spans)
    begin, length = spans[0].start, max(DAY, spans[-1].start - spans[0].start)

    def x(span: Span) -> str:
        return f"{100.0 * (span.start - begin) / length:.1f}"

    def y(value: float) -> str:
        return f"{19.0 - 18.0 * (value - low) / ((high - low) or 1.0):.1f}"

    path, runs = "", [[spans[0]]]
    for before, one in pairwise(spans):
        if one.start - before.start > 1.5 * DAY:
            runs.append([])
        runs[-1].append(one)
    band = ""
    for run in runs:
        path += "M" + "L".join(f"{x(one)} {y(one.mean)}" for one in run)
        edge = [f"{x(one)} {y(one.maximum)}" for one in run] + [
            f"{x(one)} {y(one.minimum)}" for one in run[::-1]
        ]
        band += "M" + "L".join(edge) + "Z"
    return Course(text, path, band)
