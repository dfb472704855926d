"""What the monitors keep, for browsers: the last hour, the journals, the figures of the alarms."""

from __future__ import annotations

import asyncio
import csv
import io
import re
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from spool_core.errors import InputError
from spool_core.events.event import Severity, snapshot_name
from spool_core.events.language import LANGUAGES
from spool_monitor.alarm import Input
from spool_monitor.alarm_statistics import AlarmLimits, figures, statistics
from spool_monitor.journal import COLUMNS, JournalEntry, cells, entries_in
from spool_monitor.listener import HeardValve
from spool_monitor.state_database import FILE, own_file
from spool_monitor.state_file import valve_folder
from spool_monitor.trend import MINUTE, TrendStore
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response

from spool_view.operator import Desk
from spool_view.view import PATIENCE, RANGES, limits_of, rounded, trend_of

#: Parameters whose last hour a tile shows.
SPARKS = ("natural_frequency", "viscous_coefficient", "coulomb_force")
HOUR = 3600
#: s that sparklines are held: the monitor writes a value a minute.
HELD = 30.0
#: Entries of the journal that a browser gets at most, the newest: chosen, a narrower search finds older ones.
MOST_ENTRIES = 1000
#: Readings at a time: chosen, more would hold up what the monitors write.
MOST_READINGS = 2
#: Characters of a search: chosen, more words than anybody types.
LONGEST = 200
Found = TypeVar("Found")
#: Called with a valve whose trends or journal can't be read, and why.
Failed: TypeAlias = Callable[[str, InputError | OSError], object]

PERIODS = {"day": 86400, "week": 7 * 86400, "month": 30 * 86400, "all": 0}


@dataclass(slots=True)
class Sparks:
    """Sparklines of all valves, read again after :data:`HELD` s.

    Attributes:
        base: the monitors' ``state_folder``.
        failed: called with a valve that can't be read, and why.
    """

    base: Path
    failed: Failed = lambda *_: None
    _read: float = field(default=-HELD, init=False)
    _held: dict[str, list[dict[str, Any]]] = field(default_factory=dict, init=False)

    def of(self, valves: Mapping[str, HeardValve]) -> dict[str, list[dict[str, Any]]]:
        """Return the courses of each valve that keeps trends, with known baseline and limits."""
        now = time.monotonic()
        if now - self._read >= HELD:
            self._read = now
            found = {name: self._courses(name, valve) for name, valve in list(valves.items())}
            self._held = {name: courses for name, courses in found.items() if courses}
        return self._held

    def _courses(self, name: str, valve: HeardValve) -> list[dict[str, Any]]:
        now = int(time.time())
        path = own_file(valve_folder(self.base, name) / FILE, PATIENCE)
        try:
            with closing(TrendStore(path, read_only=True)) as store:
                spans = {one: store.spans(one, MINUTE, now - HOUR) for one in SPARKS}
        except (InputError, OSError) as error:
            self.failed(name, error)
            return []
        return [
            {
                "name": parameter,
                "until": now - now % MINUTE,
                "start": [span.start for span in found],
                "mean": [rounded(span.mean, 4) for span in found],
                **limits_of(valve, parameter),
            }
            for parameter, found in spans.items()
        ]


def history(
    base: Path, valves: Iterable[str], search: str, span: tuple[int, int], language: str,
    failed: Failed = lambda *_: None,
) -> dict[str, Any]:  # fmt: skip
    """Return the newest entries of the journals of ``valves`` that hold ``search``, and the alarms' figures.

    Args:
        base: the monitors' ``state_folder``.
        valves: namespaces.
        search: words; each has to be in an entry.
        span: begin (0: all there is) and end, ns since 1970.
        language: of the headlines.
        failed: called with a valve whose journal can't be read, and why.
    """
    journals = _journals(base, valves, failed)
    rows = _found(journals, search, span, language)
    entries = [
        {
            "time": one.stamp // 1_000_000_000,
            "valve": valve,
            **{name: getattr(one, name) for name in ("action", "alarm", "code", "who", "comment")},
            "text": one.headline(LANGUAGES[language]),
            **(_of_raised(valve, one, language) if one.action == Input.RAISE.value else {}),
        }
        for valve, one in rows[-MOST_ENTRIES:][::-1]
    ]
    first = min((one.stamp for some in journals.values() for one in some), default=span[1] - 1)
    counted = statistics(journals, span[0] or first, span[1])
    return {
        "count": len(rows),
        "entries": entries,
        "figures": [
            {"name": name, "value": value, "limit": limit, "kept": kept}
            for name, value, limit, kept in figures(counted, AlarmLimits())
        ],
        "frequent": [{**asdict(one), "share": f"{100.0 * one.share:.0f}"} for one in counted.frequent],
    }


def _of_raised(valve: str, one: JournalEntry, language: str) -> dict[str, str]:
    """Return what to do about a raised alarm, and the name of the recording of its minutes."""
    event = one.said
    recorded = event is not None and event.severity is Severity.ALARM
    return {
        "advice": LANGUAGES[language].event(one.code).advice,
        "snapshot": snapshot_name(valve, event.kind, event.stamp) if event is not None and recorded else "",
    }


def history_table(
    base: Path, valves: Iterable[str], search: str, span: tuple[int, int], language: str,
    failed: Failed = lambda *_: None,
) -> str:  # fmt: skip
    """Return what :func:`history` finds as CSV, all of it, oldest first; times in UTC."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for valve, one in _found(_journals(base, valves, failed), search, span, language):
        table.writerow(cells(valve, one, LANGUAGES[language]))
    return text.getvalue()


class Records:
    """Records of one page; of valves that are heard only."""

    def __init__(self, desk: Desk, language: Callable[[Request], str]) -> None:
        self._desk, self._language = desk, language
        self._free: asyncio.Semaphore | None = None
        self._sparks = Sparks(desk.state_folder, self._failed)
        self._unread: set[str] = set()

    async def trend(self, request: Request) -> Response:
        """Answer with a trend."""
        valve, length = request.query_params.get("valve", ""), request.query_params.get("range", "day")
        parameter, since = request.query_params.get("parameter", ""), request.query_params.get("since", "0")
        wrong = len(parameter) > 200 or not re.fullmatch(r"[0-9]{1,12}", since)
        if valve not in self._desk.valves or length not in RANGES or wrong:
            return _nothing()
        base = self._desk.state_folder
        try:
            limits = partial(limits_of, self._desk.valves[valve])
            found = await self._read(lambda: trend_of(base, valve, parameter, length, int(since), limits))
        except (InputError, OSError) as error:  # names files: not for browsers
            self._failed(valve, error)
            return _nothing()
        return JSONResponse(found)

    async def sparks(self, _request: Request) -> Response:
        """Answer with the last hour of every valve."""
        found = await self._read(lambda: self._sparks.of(self._desk.valves))
        return JSONResponse({"valves": found})

    async def history(self, request: Request) -> Response:
        """Answer with the journals' entries that are searched for, and the figures of the alarm system."""
        return await self._searched(request, history, JSONResponse)

    async def history_table(self, request: Request) -> Response:
        """Answer with the same as CSV."""
        name = f"alarms_{datetime.now(timezone.utc):%Y%m%d}.csv"
        headers = {"content-disposition": f'attachment; filename="{name}"'}
        table = partial(Response, media_type="text/csv; charset=utf-8", headers=headers)
        return await self._searched(request, history_table, table)

    def _failed(self, valve: str, error: InputError | OSError) -> None:
        """Log once for each valve what can't be read; a file that is not there yet is no fault."""
        if isinstance(error, OSError) and valve not in self._unread:
            self._unread.add(valve)
            self._desk.warn(f"trends and journal of {valve} can't be read, the page shows none: {error}")

    async def _searched(
        self,
        request: Request,
        read: Callable[[Path, list[str], str, tuple[int, int], str, Failed], Found],
        answer: Callable[[Found], Response],
    ) -> Response:
        search, length = request.query_params.get("search", ""), request.query_params.get("range", "week")
        ends = [request.query_params.get(end, "") for end in ("since", "until")]
        if (
            len(search) > LONGEST
            or length not in PERIODS
            or not all(re.fullmatch("[0-9]{0,10}", one) for one in ends)
        ):
            return PlainTextResponse("no such search", 400)
        now = time.time_ns()
        begin, end = (int(one) * 1_000_000_000 if one else 0 for one in ends)
        if not any(ends) and PERIODS[length]:
            begin = now - PERIODS[length] * 1_000_000_000
        span = begin, max(begin, end or now)
        names, language = list(self._desk.valves), self._language(request)
        base = self._desk.state_folder
        return answer(await self._read(lambda: read(base, names, search, span, language, self._failed)))

    async def _read(self, read: Callable[[], Found]) -> Found:
        self._free = self._free or asyncio.Semaphore(MOST_READINGS)
        async with self._free:
            return await run_in_threadpool(read)

    async def gap(self, request: Request) -> Response:
        """Answer with everything that the last gap analysis of a valve found."""
        valve = self._desk.valves.get(request.query_params.get("valve", ""))
        message = valve.gap if valve is not None else None
        if message is None or not message.json:
            return PlainTextResponse("no analysis is held: open the valve's page first", 404)
        name = f"gap_{message.header.stamp.sec}.json"
        headers = {"content-disposition": f'attachment; filename="{name}"'}
        return Response(message.json, media_type="application/json", headers=headers)


def _journals(base: Path, valves: Iterable[str], failed: Failed) -> dict[str, list[JournalEntry]]:
    journals = {}
    for name in valves:
        path = own_file(valve_folder(base, name) / FILE, PATIENCE)
        try:
            journals[name] = entries_in(path)
        except (InputError, OSError) as error:
            failed(name, error)
    return journals


def _found(
    journals: Mapping[str, list[JournalEntry]], search: str, span: tuple[int, int], language: str
) -> list[tuple[str, JournalEntry]]:
    words = search.casefold().split()
    rows = [
        (valve, one)
        for valve, entries in journals.items()
        for one in entries
        if span[0] <= one.stamp < span[1]
        and all(
            word in " ".join(map(str, cells(valve, one, LANGUAGES[language]))).casefold() for word in words
        )
    ]
    return sorted(rows, key=lambda pair: pair[1].stamp)


def _nothing() -> Response:
    """Answer that there is none: no fault, a monitor that has just begun has kept nothing yet."""
    return JSONResponse({"parameters": [], "start": []})
