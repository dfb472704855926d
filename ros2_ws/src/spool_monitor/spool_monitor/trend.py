"""History of one valve: minimum, mean and maximum per minute, hour and day, in one SQLite file."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from types import MappingProxyType

from spool_core.kernels.strokes import Stroke
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import QUANTITIES, Estimate

from spool_monitor.state_database import StateDatabase, named

MINUTE, HOUR, DAY = 60, 3600, 86400

#: How many spans of each length (s) are kept of each parameter: a week, two years, twenty years.
KEPT: MappingProxyType[int, int] = MappingProxyType({MINUTE: 7 * 1440, HOUR: 2 * 8766, DAY: 20 * 366})

#: Writings between two looks for what is older: chosen, what is kept longer does no harm.
FORGET_EVERY = 100

#: Spans that are held at most while the file can't be written: a day of minutes of 20 parameters.
MOST_HELD = 20 * 1440

_SCHEMA = """
CREATE TABLE IF NOT EXISTS series (id INTEGER PRIMARY KEY, name TEXT UNIQUE NOT NULL, unit TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS span (
    series INTEGER NOT NULL REFERENCES series, seconds INTEGER NOT NULL, start INTEGER NOT NULL,
    count INTEGER NOT NULL, total REAL NOT NULL, minimum REAL NOT NULL, maximum REAL NOT NULL,
    PRIMARY KEY (series, seconds, start)) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS counter (series INTEGER PRIMARY KEY REFERENCES series, value REAL NOT NULL);
CREATE TABLE IF NOT EXISTS newest (id INTEGER PRIMARY KEY CHECK (id = 1), writing TEXT NOT NULL);
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
_UNITS = "SELECT name, unit FROM series ORDER BY id"
_COUNTERS = "SELECT name, value FROM counter JOIN series ON series = id"
_SPANS = (
    "SELECT start, count, minimum, total / count, maximum FROM span JOIN series ON series = id "
    "WHERE name = ? AND seconds = ? AND start >= ? ORDER BY start"
)


@dataclass(frozen=True, slots=True)
class Span:
    """Span of a trend: what a parameter did in one that began at ``start`` (s since 1970)."""

    start: int
    count: int
    minimum: float
    mean: float
    maximum: float


@dataclass(slots=True)
class Sums:
    """Sums gathered since the last writing, by parameter, length of the span (s) and its start (s)."""

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
        quantities: list[Quantity] = [*estimate.parameters, *(getattr(estimate, name) for name in QUANTITIES)]
        for quantity in quantities:
            if quantity.validity is Validity.VALID:
                self.add(estimate.stamp, quantity.name, quantity.unit, quantity.value)

    def add_stroke(self, stroke: Stroke) -> None:
        """Take the times of a stroke, and count it."""
        name = "stroke_time" if stroke.out else "return_time"
        for one, unit, value in (
            (name, "s", stroke.travel_time),
            ("stroke_delay", "s", stroke.delay),
            ("stroke_rebound", "1", stroke.rebound),
        ):
            self.add(stroke.stamp, one, unit, value)
        self.count("strokes", "1", 1.0)

    def count(self, name: str, unit: str, amount: float) -> None:
        """Add ``amount`` to a counter."""
        self.units[name] = unit
        self.counts[name] = self.counts.get(name, 0.0) + amount

    def merge(self, other: Sums, most: int = MOST_HELD) -> int:
        """Add what ``other`` gathered; of more than ``most`` spans the oldest minutes, then hours go.

        Returns:
            How many spans were dropped.

        """
        self.units |= other.units
        for name, amount in other.counts.items():
            self.counts[name] = self.counts.get(name, 0.0) + amount
        for key, (count, total, low, high) in other.spans.items():
            own = self.spans.get(key, (0, 0.0, low, high))
            self.spans[key] = (own[0] + count, own[1] + total, min(own[2], low), max(own[3], high))
        surplus = max(0, len(self.spans) - most)
        if surplus:
            for key in sorted(self.spans, key=lambda one: (one[1], one[2]))[:surplus]:
                del self.spans[key]
        return surplus


class TrendStore(StateDatabase):
    """Trends and counters in one valve's file; errors as of :class:`StateDatabase`."""

    SCHEMA = _SCHEMA
    PROBES = ("SELECT count FROM span LIMIT 1", "SELECT value FROM counter LIMIT 1")
    _writes = 0

    def write(self, sums: Sums, stamp: int = 0, writing: str = "") -> None:
        """Add ``sums`` to what there is, all or nothing; counters show at ``stamp`` (ns).

        ``writing`` names it for :meth:`newest`.

        Raises:
            InputError: the file is damaged.
            OSError: it could not be written, or the disk did not answer: then it may be there all the same.
                ``sums`` is as before.

        """
        self.check_file()
        with named(self.path), self.base:
            self.base.execute("INSERT OR REPLACE INTO newest VALUES (1, ?)", (writing,))
            self.base.executemany(
                "INSERT INTO series (name, unit) VALUES (?, ?) "
                "ON CONFLICT DO UPDATE SET unit = excluded.unit",
                sums.units.items(),
            )
            shown = Sums()
            for name, amount in sums.counts.items():
                self.base.execute(
                    "INSERT INTO counter VALUES ((SELECT id FROM series WHERE name = ?), ?) "
                    "ON CONFLICT DO UPDATE SET value = value + excluded.value",
                    (name, amount),
                )
                if stamp:
                    shown.add(stamp, name, sums.units[name], self.counters()[name])
            for spans in (sums.spans, shown.spans):
                self.base.executemany(_ADD, ((*key, *values) for key, values in spans.items()))
            if self._writes % FORGET_EVERY == 0:
                for (series,) in self.base.execute("SELECT id FROM series").fetchall():
                    kept = [{"series": series, "seconds": one, "kept": most} for one, most in KEPT.items()]
                    self.base.executemany(_FORGET, kept)
        self._writes += 1

    def newest(self) -> str:
        """Return the name of the newest writing, empty before the first; errors as of :meth:`spans`."""
        return next((str(name) for (name,) in self.ask("SELECT writing FROM newest", (str,))), "")

    def units(self) -> dict[str, str]:
        """Return the unit of every parameter by its name; errors as of :meth:`spans`."""
        return dict(self.ask(_UNITS, (str, str)))

    def counters(self) -> dict[str, float]:
        """Return the counters by name, in the units of :meth:`units`; errors as of :meth:`spans`."""
        return {name: float(value) for name, value in self.ask(_COUNTERS, (str, (int, float)))}

    def spans(self, name: str, seconds: int, since: int = 0) -> list[Span]:
        """Return the spans of ``seconds`` that began at ``since`` (s since 1970) or later, oldest first.

        Raises:
            InputError: the file is damaged.
            OSError: it can't be read.

        """
        number = (int, float)
        rows = self.ask(_SPANS, (int, int, number, number, number), (name, seconds, since))
        return [Span(*row) for row in rows]


def finest(lengths: Iterable[int], duration: float, most: int = 1500) -> int:
    """Return the shortest of ``lengths`` (s) that cuts ``duration`` s into ``most`` spans or fewer."""
    ordered = sorted(lengths)
    return next((seconds for seconds in ordered if duration / seconds <= most), ordered[-1])
