"""`./spool alarm history` and `statistics`: journals of the monitors, figures of the alarm system."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path

from spool_core.errors import InputError
from spool_core.events.sentences import language_of
from spool_core.text import plural
from spool_monitor import alarm_statistics
from spool_monitor.journal import COLUMNS, cells, entries_in, iso
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
    for title, pairs in (("chattering", found.chattering), ("active for a day or longer", found.stale)):
        if pairs:
            console.print(
                f"{title}: {', '.join(f'{valve} {alarm}' for valve, alarm in pairs)}", soft_wrap=True
            )
