"""Journal of one valve's alarms and of who did what, in the file of its trends (ISA-18.2, 16: records)."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from dataclasses import dataclass, fields
from datetime import datetime, timezone
from pathlib import Path

from pydantic import TypeAdapter, ValidationError
from spool_core.events.event import Event
from spool_core.events.language import ENGLISH, Language
from spool_core.events.sentences import headline

from spool_monitor.state_database import PATIENCE, StateDatabase, named

#: Days that entries are kept for by default.
DAYS = 30.0

#: Entries that are kept at most: an alarm that comes and goes each second fills a day.
MOST_ENTRIES = 100_000

#: Writings between two looks for what is older: chosen, what is kept longer does no harm.
FORGET_EVERY = 100

_DAY = 86_400_000_000_000
_EVENT = TypeAdapter(Event)

#: Columns of a journal as a table; times are UTC in ISO 8601.
COLUMNS = (
    "time", "valve", "action", "alarm", "code", "namur", "severity", "state", "occurrence", "who", "comment",
    "value", "unit", "text",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One transition of an alarm, or one act on the baseline.

    Attributes:
        stamp: ns since 1970, of the monitor's clock or of the event.
        action: an :class:`~spool_monitor.alarm.Input`, or ``baseline``.
        alarm: name of the alarm; empty for the baseline.
        code: number of kind and cause.
        namur: letter of NE 107 that the alarm's kind gives the valve.
        severity: ``warning`` or ``alarm``.
        state: that the alarm shows after it.
        occurrence: number of the alarm's announcement.
        who: operator; empty where the monitor or the time did it.
        comment: the operator's.
        text: headline in English.
        value: that was judged, in ``unit``; ``None``: not known.
        event: the event as JSON, from which the headline is composed in other languages; empty: none.
    """

    stamp: int
    action: str
    alarm: str = ""
    code: int = 0
    namur: str = ""
    severity: str = ""
    state: str = ""
    occurrence: int = 0
    who: str = ""
    comment: str = ""
    text: str = ""
    value: float | None = None
    unit: str = ""
    event: str = ""

    @property
    def said(self) -> Event | None:
        """The event; ``None`` where none is kept, or it cannot be read."""
        try:
            return _EVENT.validate_python(json.loads(self.event)) if self.event else None
        except (ValidationError, ValueError):
            return None

    def headline(self, language: Language) -> str:
        """Return the headline in ``language``, in English where the event cannot be read."""
        found = self.said if language is not ENGLISH else None
        return self.text if found is None else headline(found, language)


_FIELDS = tuple(one.name for one in fields(JournalEntry))
_KINDS = (int, str, str, int, str, str, str, int, str, str, str, (int, float, type(None)), str, str)
_COLUMNS = ", ".join(_FIELDS)


class Journal(StateDatabase):
    """Journal in one valve's file, bounded in time and number; errors as of :class:`StateDatabase`."""

    SCHEMA = (
        "CREATE TABLE IF NOT EXISTS journal (id INTEGER PRIMARY KEY AUTOINCREMENT, stamp INTEGER NOT NULL, "
        + ", ".join(f"{name} NOT NULL" if name != "value" else name for name in _FIELDS[1:])
        + "); CREATE INDEX IF NOT EXISTS journal_stamp ON journal (stamp);"
    )

    def __init__(
        self, path: Path, days: float = DAYS, *, read_only: bool = False, patience: float = PATIENCE
    ) -> None:
        super().__init__(path, read_only=read_only, patience=patience)
        self.days = days
        self._writes = 0

    def write(self, entries: Iterable[JournalEntry]) -> None:
        """Append ``entries``, all or none; what is too old goes now and then.

        Raises:
            InputError: the file is damaged.
            OSError: it could not be written.

        """
        self.check_file()
        rows = [tuple(getattr(one, name) for name in _FIELDS) for one in entries]
        with named(self.path), self.base:
            marks = ", ".join("?" * len(_FIELDS))
            self.base.executemany(f"INSERT INTO journal ({_COLUMNS}) VALUES ({marks})", rows)
            if self._writes % FORGET_EVERY == 0 and rows:
                # An entry of a source whose clock is ahead must not make all the others old.
                oldest = min(max(row[0] for row in rows), time.time_ns()) - round(self.days * _DAY)
                self.base.execute("DELETE FROM journal WHERE stamp < ?", (oldest,))
                self.base.execute(
                    "DELETE FROM journal WHERE id <= (SELECT max(id) FROM journal) - ?", (MOST_ENTRIES,)
                )
        self._writes += 1

    def entries(self, since: int = 0, until: int = 2**63 - 1) -> list[JournalEntry]:
        """Return the entries from ``since`` to before ``until`` (ns since 1970) in the order of writing.

        Raises:
            InputError: the file is damaged.
            OSError: it can't be read.

        """
        if not self.ask("SELECT name FROM sqlite_master WHERE name = 'journal'", (str,)):
            return []  # written by a version without a journal
        question = f"SELECT {_COLUMNS} FROM journal WHERE stamp >= ? AND stamp < ? ORDER BY id"
        return [JournalEntry(*row) for row in self.ask(question, _KINDS, (since, until))]

    def newest(self, count: int) -> list[JournalEntry]:
        """Return the last ``count`` entries in the order of writing; errors as of :meth:`entries`."""
        question = f"SELECT {_COLUMNS} FROM journal ORDER BY id DESC LIMIT ?"
        return [JournalEntry(*row) for row in reversed(self.ask(question, _KINDS, (count,)))]


def entries_in(path: Path, since: int = 0, until: int = 2**63 - 1) -> list[JournalEntry]:
    """Return the entries of a valve's file; see :meth:`Journal.entries`."""
    journal = Journal(path, read_only=True)
    try:
        return journal.entries(since, until)
    finally:
        journal.close()


def cells(valve: str, one: JournalEntry, language: Language) -> tuple[object, ...]:
    """Return the cells of an entry of ``valve`` under :data:`COLUMNS`; unknown ones are empty."""
    return (
        iso(one.stamp), valve, one.action, one.alarm, one.code or "", one.namur, one.severity, one.state,
        one.occurrence or "", one.who, one.comment, "" if one.value is None else one.value, one.unit,
        one.headline(language),
    )  # fmt: skip


def iso(stamp: int) -> str:
    """Return the time (UTC) of ``stamp`` (ns since 1970) in ISO 8601."""
    return datetime.fromtimestamp(stamp / 1e9, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
