"""Manifest of a fleet store: its bags, what was found in each, service events; one SQLite file.

It holds everything: the Parquet tables are made from it. A kill at any moment loses at most what was not
committed, which the next run does again.
"""

from __future__ import annotations

import importlib
import json
import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, TypeAlias

from spool_core.errors import InputError

FILE_NAME = "manifest.sqlite"
#: Rows by table, without the columns of the record.
Rows: TypeAlias = dict[str, list[list[Any]]]
#: Format of the file; 1, in which only the tables had the rows, is taken over, another one is refused.
FORMAT, OLDER = 2, 1
#: s.
DAY = 86_400.0
#: s to wait for another process that writes: tables of a month of 100,000 bags take half a minute.
PATIENCE = 300.0
#: Month in which a record began, such as ``2026-03``.
_MONTH = "strftime('%Y-%m', start / 1000000000, 'unixepoch')"
_TABLES = """
CREATE TABLE IF NOT EXISTS bags (
    path TEXT, namespace TEXT, content TEXT, stamp TEXT, machine TEXT, valve TEXT, start INTEGER,
    duration REAL, rate REAL, lost INTEGER, temperature REAL, status TEXT, reason TEXT, valve_file TEXT,
    PRIMARY KEY (path, namespace)) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS bags_by_content ON bags (content);
CREATE INDEX IF NOT EXISTS bags_by_start ON bags (start);
CREATE TABLE IF NOT EXISTS results (
    path TEXT, namespace TEXT, analysis TEXT, key TEXT, status TEXT, reason TEXT, rows BLOB,
    PRIMARY KEY (path, namespace, analysis)) WITHOUT ROWID;
CREATE INDEX IF NOT EXISTS results_by_key ON results (path, namespace, analysis, key);
DROP INDEX IF EXISTS results_waiting;
CREATE TABLE IF NOT EXISTS services (
    machine TEXT, valve TEXT, start INTEGER, kind TEXT, comment TEXT,
    PRIMARY KEY (machine, valve, start, kind)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS outdated (month TEXT PRIMARY KEY) WITHOUT ROWID;
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """Entry of the catalogue: the record of one valve in one bag; its fields are the columns of ``bags``.

    Attributes:
        path: of the bag.
        namespace: of the valve in the bag, empty where a damaged bag tells none.
        content: SHA-256 of the bag.
        machine, valve: the identity.
        start: ns since 1970, UTC.
        duration: s.
        rate: of sampling, Hz; ``None`` where it is not known, as ``temperature`` of the oil, deg C.
        lost: blocks.
        status, reason: as ``Scan``; a duplicate names the bag that it repeats.
        valve_file: description to take instead of the bag's, a file or a shipped valve's name; may be empty.
        stamp: size and time of modification of its files, by which a change is noticed.
    """

    path: str
    namespace: str
    content: str
    stamp: str
    machine: str
    valve: str
    start: int
    duration: float
    rate: float | None
    lost: int
    temperature: float | None
    status: str
    reason: str
    valve_file: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one analysis of one valve's record: its rows, or why there are none."""

    namespace: str
    analysis: str
    status: str
    reason: str
    rows: Rows


@dataclass(frozen=True, slots=True)
class Service:
    """What was done to a valve, or to all of a machine (``valve`` empty), and when (ns)."""

    machine: str
    valve: str
    start: int
    kind: str
    comment: str = ""

    @property
    def day(self) -> float:
        """Day since 1970."""
        return self.start / 1e9 / DAY

    def concerns(self, machine: str, valve: str) -> bool:
        """Return whether it was done to this valve."""
        return self.machine in ("", machine) and self.valve in ("", valve)


class Manifest:
    """Manifest in the folder ``store``; ``make`` makes it where it is missing.

    Raises:
        InputError: the store is missing, or is not a fleet store.
    """

    def __init__(self, store: Path, *, make: bool = False) -> None:
        self.store = store
        file = store / FILE_NAME
        if not file.is_file() and not make:
            raise InputError(f"{store}: no fleet store: make one by ./spool fleet add FOLDER --store {store}")
        try:
            store.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(file, timeout=PATIENCE, isolation_level=None)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=NORMAL")
            self._db.executescript(_TABLES)
            version = self._version()
            if version in (0, OLDER):
                with self.transaction():
                    if self._version() == OLDER:  # no other process was first
                        self._take_over()
                    self._db.execute(f"PRAGMA user_version={FORMAT}")
        except (sqlite3.Error, OSError) as error:
            raise InputError(f"{file}: cannot be used as a fleet store: {error}") from error
        if version not in (0, OLDER, FORMAT):
            raise InputError(
                f"{file}: another version of the suite wrote it (format {version}): use another store"
            )

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    # Catalogue

    def stamp_of(self, path: str) -> str | None:
        """Return the stamp of a bag that is in the catalogue, else ``None``."""
        row = self._db.execute("SELECT stamp FROM bags WHERE path = ? LIMIT 1", (path,)).fetchone()
        return None if row is None else str(row[0])

    def of(self, path: str) -> list[Entry]:
        """Return the records of the bag at ``path``."""
        return self._entries("WHERE path = ?", (path,))

    def first_with(self, content: str, other_than: str) -> str | None:
        """Return the path of a bag with the same content that is no duplicate, if there is one."""
        row = self._db.execute(
            "SELECT path FROM bags WHERE content = ? AND path != ? AND status != 'duplicate' "
            "ORDER BY path LIMIT 1",
            (content, other_than),
        ).fetchone()
        return None if row is None else str(row[0])

    def put(self, path: str, entries: Iterable[Entry]) -> None:
        """Put the records of a bag in place of those it had; changed ones lose their results."""
        new = {entry.namespace: entry for entry in entries}
        with self.transaction():
            old = {entry.namespace: entry for entry in self.of(path)}
            if old == new:
                return
            self._outdate(path)
            self._db.execute("DELETE FROM bags WHERE path = ?", (path,))
            for name in old.keys() | new.keys():
                if name not in old or name not in new or _content(old[name]) != _content(new[name]):
                    self._db.execute("DELETE FROM results WHERE path = ? AND namespace = ?", (path, name))
            self._db.executemany(
                f"INSERT INTO bags VALUES ({','.join('?' * 14)})", [astuple(entry) for entry in new.values()]
            )
            self._outdate(path)

    def entries(self, month: str | None = None) -> Iterator[Entry]:
        """Yield all records, or those of ``month``, by machine, valve and start."""
        where, values = ("", ()) if month is None else (f"WHERE {_MONTH} = ? ", (month,))
        yield from self._entries(f"{where}ORDER BY machine, valve, start, path, namespace", values)

    def months(self) -> list[str]:
        """Return the months in which records began."""
        return [
            month for (month,) in self._db.execute(f"SELECT DISTINCT {_MONTH} AS month FROM bags ORDER BY 1")
        ]

    # Results

    def due(self, keys: Mapping[str, str]) -> dict[str, dict[str, list[str]]]:
        """Return the analyses that are missing or of another key than in ``keys``, by path and namespace."""
        done = set(self._db.execute("SELECT path, namespace, analysis, key FROM results"))
        found: dict[str, dict[str, list[str]]] = {}
        for path, namespace in self._db.execute(
            "SELECT path, namespace FROM bags WHERE status = 'ok' ORDER BY path, namespace"
        ).fetchall():
            missing = [one for one, key in keys.items() if (path, namespace, one, key) not in done]
            if missing:
                found.setdefault(path, {})[namespace] = missing
        return found

    def keep(self, path: str, keys: Mapping[str, str], results: Iterable[Outcome]) -> None:
        """Keep results of the bag at ``path``, each with the key of its analysis, in one transaction."""
        with self.transaction():
            for one in results:
                self._db.execute(
                    "INSERT OR REPLACE INTO results VALUES (?,?,?,?,?,?,?)",
                    (path, one.namespace, one.analysis, keys[one.analysis], one.status, one.reason,
                     _packed(one.rows)),
                )  # fmt: skip
            self._outdate(path)

    def results(self, path: str, namespace: str) -> list[Outcome]:
        """Return the results of one record by name of the analysis."""
        rows = self._db.execute(
            "SELECT analysis, status, reason, rows FROM results WHERE path = ? AND namespace = ? "
            "ORDER BY analysis",
            (path, namespace),
        ).fetchall()
        return [
            Outcome(namespace, name, status, reason, json.loads(zlib.decompress(packed)))
            for name, status, reason, packed in rows
        ]

    def outdated(self) -> list[str]:
        """Return the months whose tables lack something."""
        return [month for (month,) in self._db.execute("SELECT month FROM outdated ORDER BY month")]

    def written(self, month: str) -> None:
        """Note that the tables of ``month`` are complete."""
        self._db.execute("DELETE FROM outdated WHERE month = ?", (month,))

    # Service events

    def add_service(self, service: Service) -> None:
        """Take a service event."""
        self._db.execute(
            "INSERT OR REPLACE INTO services VALUES (?,?,?,?,?)",
            (service.machine, service.valve, service.start, service.kind, service.comment),
        )

    def services(self) -> list[Service]:
        """Return the service events in order of time."""
        rows = self._db.execute("SELECT * FROM services ORDER BY start, machine, valve, kind").fetchall()
        return [Service(*row) for row in rows]

    def _entries(self, rest: str, values: tuple[str, ...] = ()) -> list[Entry]:
        return [Entry(*row) for row in self._db.execute(f"SELECT * FROM bags {rest}", values).fetchall()]

    def _version(self) -> int:
        return int(self._db.execute("PRAGMA user_version").fetchone()[0])

    def _outdate(self, path: str) -> None:
        """Note that the tables lack something of the bag at ``path``."""
        self._db.execute(f"INSERT OR IGNORE INTO outdated SELECT {_MONTH} FROM bags WHERE path = ?", (path,))

    def _take_over(self) -> None:
        """Take the rows of a store of the older format from its tables; what is lost there is due again."""
        # That module writes the tables, and so imports this one.
        rows_in_tables = importlib.import_module(f"{__package__}.parquet").rows_in_tables
        for month in self.months():
            held = rows_in_tables(self.store, month)
            if held is None:
                continue
            for entry in self.entries(month):
                whose = (entry.path, entry.namespace)
                names = self._db.execute(
                    "SELECT analysis FROM results WHERE path = ? AND namespace = ? AND rows IS NULL", whose
                ).fetchall()
                for (name,) in names:
                    self._db.execute(
                        "UPDATE results SET rows = ? WHERE path = ? AND namespace = ? AND analysis = ?",
                        (_packed(held.get((entry.path, entry.valve, name), {})), *whose, name),
                    )
        self._db.execute("DELETE FROM results WHERE rows IS NULL")

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """Keep other processes from writing meanwhile; all of it counts, or nothing after an error."""
        self._db.execute("BEGIN IMMEDIATE")
        with self._db:  # commits, or takes back on an error
            yield


def _packed(rows: dict[str, list[list[Any]]]) -> bytes:
    return zlib.compress(json.dumps(rows, separators=(",", ":")).encode())


def _content(entry: Entry) -> tuple[str, ...]:
    """Return what the results of a record follow from."""
    return entry.content, entry.valve_file, entry.status
