"""History of one valve: minimum, mean and maximum per minute, hour and day, in one SQLite file."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from spool_estimator.estimate import Estimate
from spool_stream.errors import InputError
from spool_stream.quantity import Quantity, Validity

MINUTE, HOUR, DAY = 60, 3600, 86400

#: How many spans of each length (s) are kept of each parameter: a week, two years, twenty years.
KEPT: MappingProxyType[int, int] = MappingProxyType({MINUTE: 7 * 1440, HOUR: 2 * 8766, DAY: 20 * 366})

#: Of the estimate, beside the model's parameters.
FOLLOWED = (
    "referred_viscous_coefficient", "oil_temperature", "natural_frequency", "damping_ratio", "residual",
    "excitation", "relative_displacement",
)  # fmt: skip

#: Writings between two looks for what is older.
FORGET_EVERY = 100

_SCHEMA = """
CREATE TABLE IF NOT EXISTS series (id INTEGER PRIMARY KEY, name TEXT UNIQUE NOT NULL, unit TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS span (
    series INTEGER NOT NULL REFERENCES series, seconds INTEGER NOT NULL, start INTEGER NOT NULL,
    count INTEGER NOT NULL, total REAL NOT NULL, minimum REAL NOT NULL, maximum REAL NOT NULL,
    PRIMARY KEY (series, seconds, start)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS counter (series INTEGER PRIMARY KEY REFERENCES series, value REAL NOT NULL);
"""
_ADD = """
INSERT INTO span VALUES ((SELECT id FROM series WHERE name = ?), ?, ?, ?, ?, ?, ?)
ON CONFLICT DO UPDATE SET count = count + excluded.count, total = total + excluded.total,
    minimum = min(minimum, excluded.minimum), maximum = max(maximum, excluded.maximum)
"""
_FORGET = """
DELETE FROM span WHERE series = :series AND seconds = :seconds AND start <= (
    SELECT start FROM span WHERE series = :series AND seconds = :seconds
    ORDER BY start DESC LIMIT 1 OFFSET :kept)
"""


@dataclass(frozen=True, slots=True)
class Span:
    """What a parameter did in one span that began at ``start`` (s since 1970)."""

    start: int
    count: int
    minimum: float
    mean: float
    maximum: float


@dataclass(slots=True)
class Sums:
    """What was gathered since the last writing, by parameter, length of the span (s) and its start (s)."""

    spans: dict[tuple[str, int, int], tuple[int, float, float, float]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)

    def add(self, stamp: int, name: str, unit: str, value: float) -> None:
        """Take a value at ``stamp`` (ns); what is no number is left out."""
        if not math.isfinite(value):
            return
        self.units[name] = unit
        for seconds in KEPT:
            key = (name, seconds, stamp // (seconds * 1_000_000_000) * seconds)
            count, total, low, high = self.spans.get(key, (0, 0.0, value, value))
            self.spans[key] = (count + 1, total + value, min(low, value), max(high, value))

    def add_estimate(self, estimate: Estimate) -> None:
        """Take what an estimate holds that is valid; held values would repeat themselves."""
        quantities: list[Quantity] = [*estimate.parameters, *(getattr(estimate, name) for name in FOLLOWED)]
        for quantity in quantities:
            if quantity.validity is Validity.VALID:
                self.add(estimate.stamp, quantity.name, quantity.unit, quantity.value)

    def count(self, name: str, unit: str, amount: float) -> None:
        """Add ``amount`` to a counter."""
        self.units[name] = unit
        self.counts[name] = self.counts.get(name, 0.0) + amount


class TrendStore:
    """The file of one valve; a kill or a power loss costs what was not written yet, and never the file.

    Raises:
        InputError: the file is none of ours or damaged; it is named.
        OSError: it can't be opened or made.

    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self.path = path
        self._writes = 0
        if read_only and not path.is_file():
            raise InputError(f"{path}: there is no such file")
        mode = "ro" if read_only else "rwc"
        try:
            # Written by one worker thread, opened and closed by the node's.
            self._base = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}", uri=True, check_same_thread=False
            )
            if not read_only:
                self._base.execute("PRAGMA journal_mode=WAL")
                self._base.execute("PRAGMA synchronous=FULL")
                self._base.executescript(_SCHEMA)
            self._base.execute("SELECT count FROM span LIMIT 1")
            self._base.execute("SELECT value FROM counter LIMIT 1")
        except sqlite3.OperationalError as error:
            if "no such" in str(error):
                raise InputError(f"{path}: it holds no trends of a valve") from error
            raise OSError(f"{path}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise InputError(f"{path}: it is damaged ({error})") from error

    def write(self, sums: Sums, stamp: int = 0) -> None:
        """Add ``sums`` to what there is, all or nothing; counters show at ``stamp`` (ns).

        Raises:
            OSError: it could not be written.

        """
        try:
            with self._base:
                self._base.executemany(
                    "INSERT INTO series (name, unit) VALUES (?, ?) "
                    "ON CONFLICT DO UPDATE SET unit = excluded.unit",
                    sums.units.items(),
                )
                self._count(sums, stamp)
                self._base.executemany(_ADD, ((*key, *values) for key, values in sums.spans.items()))
                if self._writes % FORGET_EVERY == 0:
                    self._forget()
        except sqlite3.Error as error:
            raise OSError(f"{self.path}: {error}") from error
        self._writes += 1

    def _forget(self) -> None:
        for (series,) in self._base.execute("SELECT id FROM series").fetchall():
            self._base.executemany(
                _FORGET,
                [{"series": series, "seconds": seconds, "kept": kept} for seconds, kept in KEPT.items()],
            )

    def _count(self, sums: Sums, stamp: int) -> None:
        for name, amount in sums.counts.items():
            self._base.execute(
                "INSERT INTO counter VALUES ((SELECT id FROM series WHERE name = ?), ?) "
                "ON CONFLICT DO UPDATE SET value = value + excluded.value",
                (name, amount),
            )
            if stamp:
                sums.add(stamp, name, sums.units[name], self.counters()[name])

    def units(self) -> dict[str, str]:
        """Return the unit of every parameter by its name."""
        return dict(self._base.execute("SELECT name, unit FROM series ORDER BY id").fetchall())

    def counters(self) -> dict[str, float]:
        """Return the counters by name, in the units of :meth:`units`."""
        rows = "SELECT name, value FROM counter JOIN series ON series = id"
        return dict(self._base.execute(rows).fetchall())

    def spans(self, name: str, seconds: int, since: int = 0) -> list[Span]:
        """Return the spans of ``seconds`` that began at ``since`` (s since 1970) or later, oldest first."""
        rows = self._base.execute(
            "SELECT start, count, minimum, total / count, maximum FROM span JOIN series ON series = id "
            "WHERE name = ? AND seconds = ? AND start >= ? ORDER BY start",
            (name, seconds, since),
        )
        return [Span(*row) for row in rows]

    def close(self) -> None:
        """Let go of the file."""
        self._base.close()


def finest(lengths: Iterable[int], duration: float, most: int = 1500) -> int:
    """Return the shortest of ``lengths`` (s) that cuts ``duration`` s into ``most`` spans or fewer."""
    ordered = sorted(lengths)
    return next((seconds for seconds in ordered if duration / seconds <= most), ordered[-1])
