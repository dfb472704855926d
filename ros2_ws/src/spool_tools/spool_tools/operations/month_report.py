"""`./spool report`: a month of alarms, trends and losses, a page a machine, a line a valve."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from spool_core.errors import InputError
from spool_core.events.language import ENGLISH
from spool_core.events.sentences import title
from spool_core.text import plural
from spool_core.uncertainty import number
from spool_monitor.alarm_statistics import ACTIVE, AlarmLimits, statistics
from spool_monitor.journal import JournalEntry, entries_in
from spool_monitor.trend import DAY, HOUR, Span, TrendStore
from spool_report import page as html
from spool_report.outputs import check_output, write_file

from spool_tools.operations.alarm_journal import figure_table
from spool_tools.operations.valve_trend import kept_files

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
    counted = statistics(chosen, begin * _SECOND, until * _SECOND)
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
        html.table(figure_table(counted, AlarmLimits())),
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
        if one.state in ACTIVE:
            standing[one.alarm] = one
        else:
            standing.pop(one.alarm, None)
        if one.action == "raise" and one.state in ACTIVE and begin * _SECOND <= one.stamp < until * _SECOND:
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
    for before, one in itertools.pairwise(spans):
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
