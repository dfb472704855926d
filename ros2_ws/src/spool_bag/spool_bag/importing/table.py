"""Tables as loggers write them: groups of channels on one clock, held, grown or taken from arrays."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.settings import NEUTRAL, Scaling, Settings, Start, StatedRate
from spool_bag.importing.units import quantity_of, split_header

#: Samples of one record that are read: 4 hours at 2 kHz; 16 B each are kept, 24 while they are read.
MOST_SAMPLES = 30_000_000
#: Channels of one file that are looked at.
MOST_CHANNELS = 4096
#: B that a file may hold, or unpack to, where its library takes it into memory as a whole.
MOST_BYTES = 1 << 31
#: Unit of a channel whose values are whole ns (int64) since 1970, or since midnight of an unknown day.
STAMP = "stamp"

#: Channel of a bag's messages: when the recorder received them.
LOG_TIME = "log_time"

Values = NDArray[np.float64] | NDArray[np.int64]

#: Relative difference up to which an amount that a file states is the one that was read.
COUNTED_ALIKE = 1e-6

#: Samples of the first piece of memory.
_FIRST = 1 << 16

#: Names of time axes.
TIMES = ("t", "time", "zeit", "timestamp", "time_s")
#: Samples from which a row is a record; shorter ones are settings.
SHORTEST = 3


@dataclass(frozen=True, slots=True)
class Channel:
    """Channel of a file: its ``name`` there, and ``unit`` as the file has it, "" where it names none.

    ``time`` marks a time axis by the format itself; ``dated`` is False for a time of day without a date.
    ``role``: contract name where the format fixes what the channel is. ``number``: of its column in the file,
    from 0. ``own``: its name in the file where ``name`` has an index, since several channels have that name
    there. ``scaling``: how the stored numbers become those of the unit.
    """

    name: str
    unit: str = ""
    time: bool = False
    role: str = ""
    dated: bool = True
    number: int = -1
    own: str = ""
    scaling: Scaling = NEUTRAL

    @property
    def header(self) -> str:
        """Name as the file has it."""
        return self.own or self.name


@dataclass(frozen=True, slots=True)
class Group:
    """Group of channels on one clock: ``rate`` (Hz), NaN where the file does not state it.

    ``source``: where the file states the rate, e.g. ``bearing/sr``. ``start``: acquisition time of the first
    sample in ns since 1970, ``None`` where not stated. ``delay``: s, from there to the first sample.
    ``stamped``: its times are those of a clock that other groups share. ``doubt``: a setting that may be the
    rate or not. ``count``, ``span``: samples and s that the file states, NaN where it does not.
    """

    name: str
    channels: tuple[Channel, ...]
    rate: float = math.nan
    start: int | None = None
    stamped: bool = False
    source: str = ""
    delay: float = 0.0
    doubt: str = ""
    count: float = math.nan
    span: float = math.nan

    @classmethod
    def stated(
        cls, name: str, channels: Sequence[Channel], known: Settings, rate: StatedRate, of: str = ""
    ) -> Group:
        """Return a group with its ``rate``, samples and s as settings state them of the channel ``of``."""
        count, span = known.count(of), known.span(of)
        return cls(
            name, tuple(channels), rate.rate, source=rate.source, doubt=rate.doubt, count=count, span=span
        )

    def channel(self, name: str) -> Channel:
        """Return the channel that has ``name``."""
        return next(one for one in self.channels if one.name == name)


class Table(ABC):
    """What a file holds.

    ``notes``: how it was understood, ``warnings``: what is wrong with it, one line each; ``warnings`` are
    complete only after :meth:`read`. ``clocks``: of bags, header stamps and times of reception (ns, int64,
    shape (n,)) of each group that was read. ``holes_are_gaps``: rows without a value are missing samples by
    the format. ``dates``: order of day, month and year, where the user states it. ``gravity``:
    length of the mean vector of three axes, in the unit that the format prescribes, by group, once read.
    ``zoned``: its stamps are UTC by the format, or name their zone, which is known once they were read.
    ``settings``: what the file states beside its channels. ``unread``: why a column is no channel, by name.
    """

    path: Path
    groups: tuple[Group, ...]
    clocks: Mapping[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = MappingProxyType({})
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    holes_are_gaps: bool = False
    dates: str = ""
    zoned: bool = False
    gravity: Mapping[str, float] = MappingProxyType({})
    settings: Settings = Settings()
    unread: Mapping[str, str] = MappingProxyType({})

    def account(self, title: str, what: str, stated: float, read: float, off: float = COUNTED_ALIKE) -> None:
        """Warn where the file states another amount of something than was read, e.g. of messages.

        ``stated``: NaN or 0 where it does not. ``off``: relative difference that is none.
        """
        if stated and abs(read - stated) > off * stated:
            where = f"{title}: " if title else ""
            text = f"{where}the file states {stated:.7g} {what}, and {read:.7g} are read"
            self.warnings = tuple(dict.fromkeys((*self.warnings, text)))

    @abstractmethod
    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of channels of one group by name, each of shape (n,).

        Stamps are int64, all else float64, those in ``single`` may be float32.

        Raises:
            InputError: values that are no numbers, with their place.
        """

    def taken(self, group: Group, names: Sequence[str], single: Sequence[str] = ()) -> dict[str, Values]:
        """Return what :meth:`read` does, in the units of the channels, once the file's count was compared."""
        found = self.read(group, names, single)
        for name in names:
            scaling = group.channel(name).scaling
            if not scaling.applied:
                continue
            row = found[name].astype(np.float64)
            if scaling.missing:
                row = np.where(np.isin(row, np.asarray(scaling.missing)), math.nan, row)
            found[name] = row * scaling.factor + scaling.offset
        self.account(group.name, "samples", group.count, max((row.size for row in found.values()), default=0))
        return found

    def where(self, row: int) -> str:
        """Return where row ``row`` (from 0) stands, for messages."""
        return f"sample {row}"


@dataclass(eq=False)
class ArrayTable(Table):
    """Table whose channels are arrays in memory, by group and channel."""

    path: Path
    groups: tuple[Group, ...]
    arrays: Mapping[tuple[str, str], Any]
    notes: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())
    settings: Settings = field(default_factory=Settings)
    unread: Mapping[str, str] = field(default_factory=dict)

    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of channels by name."""
        return {name: as_numbers(self.path, name, self.arrays[group.name, name]) for name in names}


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """Return names without repetition: those that were get an index from 1."""
    taken = set(names)
    found: list[str] = []
    for name in names:
        if names.count(name) == 1:
            found.append(name)
            continue
        index = 1
        while f"{name}_{index}" in taken:
            index += 1
        found.append(f"{name}_{index}")
        taken.add(found[-1])
    return tuple(found)


def numbered(group: Group) -> Group:
    """Return a group whose channels have numbers: that of their column, else their place in the group."""
    channels = tuple(
        replace(one, number=at) if one.number < 0 else one for at, one in enumerate(group.channels)
    )
    return replace(group, channels=channels)


def as_numbers(path: Path, name: str, values: Any) -> Values:
    """Return an array of any kind as numbers: float64, or int64 ns since 1970 for dates.

    Raises:
        InputError: its values are no numbers.
    """
    row = np.asarray(values).reshape(-1)
    if row.size > MOST_SAMPLES:
        raise too_long(path)
    if row.dtype.kind == "M":
        return row.astype("datetime64[ns]").astype(np.int64)
    if row.dtype.kind == "m":
        return row.astype("timedelta64[ns]").astype(np.float64)
    if row.dtype.kind not in "fiub":
        raise InputError(
            f"{path}: {printable(name, 40)} holds no numbers: name another channel with --columns"
        )
    return row.astype(np.float64, copy=False)


def too_long(path: Path) -> InputError:
    """Return the error of a record that has too many samples."""
    return InputError(f"{path}: more than {MOST_SAMPLES} samples: split the file and import each part")


def check_size(path: Path, size: int | None = None) -> None:
    """Check that a file, or what it unpacks to (``size``, B), fits into memory.

    Raises:
        InputError: it does not.
    """
    found = path.stat().st_size if size is None else size
    if found > MOST_BYTES:
        raise InputError(
            f"{path}: {found / 1e9:.1f} GB, more than the {MOST_BYTES / 1e9:.1f} GB that are read of "
            "this format "
            "at once: split it, or write Parquet"
        )


class GrowingColumns:
    """Growing columns by name; those in ``single`` are held as float32.

    A row is lengthened where it lies, as the system moves pages: neither a list of pieces nor their copy
    into one row is ever held beside it.
    """

    def __init__(self, path: Path, names: Sequence[str], single: Sequence[str]) -> None:
        self.rows = 0
        self._path = path
        self._single = frozenset(single)
        self._columns: dict[str, NDArray[Any] | None] = dict.fromkeys(names)

    def add(self, piece: dict[str, NDArray[Any]]) -> None:
        """Append a piece of every column.

        Raises:
            InputError: the record is longer than :data:`MOST_SAMPLES`.
        """
        count = next(iter(piece.values())).size
        if self.rows + count > MOST_SAMPLES:
            raise too_long(self._path)
        for name, values in piece.items():
            column = self._columns[name]
            if column is None:
                kind = np.float32 if name in self._single else values.dtype
                column = self._columns[name] = np.empty(max(count, _FIRST), dtype=kind)
            if self.rows + count > column.size:
                column.resize(min(MOST_SAMPLES, max(self.rows + count, 2 * column.size)), refcheck=False)
            with np.errstate(over="ignore"):  # what float32 cannot hold is refused as infinite
                column[self.rows : self.rows + count] = values
        self.rows += count

    def take(self) -> dict[str, Values]:
        """Return the columns, shape (n,) each."""
        for column in self._columns.values():
            if column is not None:
                column.resize(self.rows, refcheck=False)
        return {name: np.empty(0) if column is None else column for name, column in self._columns.items()}


def array_table(
    path: Path,
    arrays: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> ArrayTable:
    """Return the table of named arrays: those of one length, rate and start share a clock.

    Args:
        path: of the file.
        arrays: rows, and matrices whose columns are channels, or whose rows are where these are longer.
        units: by the arrays' names, where the file states them.
        settings: numbers and texts by their paths; arrays of one number are settings as well.

    Raises:
        InputError: there is no row of numbers.
    """
    rows: dict[str, Any] = {}
    stated: dict[str, Any] = dict(settings or {})
    for name, value in arrays.items():
        parts = _rows(name, np.asarray(value))
        for at, (key, row) in enumerate(parts):
            if row.size >= SHORTEST and row.dtype.kind in "fiubMm":
                rows[key] = row
                of_column = _of_column(name, key, at, len(parts), settings or {})
                for setting in of_column:  # no longer of the whole array
                    stated.pop(f"{name}/{setting.rpartition('/')[2]}", None)
                stated |= of_column
    if not rows:
        raise InputError(f"{path}: no row of at least {SHORTEST} numbers in it")
    if len(rows) > MOST_CHANNELS:
        raise InputError(f"{path}: {len(rows)} channels, more than {MOST_CHANNELS}")
    single = {key: value for key, value in arrays.items() if np.size(value) == 1}
    known = Settings({**stated, **single})
    channels = {name: _channel(name, row, units or {}, known) for name, row in rows.items()}
    times = {
        name
        for name, channel in channels.items()
        if channel.time
        or quantity_of(channel.unit) == "time"
        or channel.name.rpartition("/")[2].lower() in TIMES
    }
    timed = {rows[name].size for name in times}
    rates = {name: known.rate(name) for name in rows}
    # Channels that have a column of times begin with it.
    starts = {name: Start() if row.size in timed else known.start(name) for name, row in rows.items()}
    clocks: dict[int, dict[tuple[float, Start], list[str]]] = {}
    for size in dict.fromkeys(row.size for row in rows.values()):
        names = [name for name, row in rows.items() if row.size == size and name not in times]
        # What one channel alone states holds for those beside it that state nothing.
        rate = _only({round(rates[name].rate, 6) for name in names if rates[name].rate > 0.0}) or 0.0
        moment = _only({start.moment for name in names if (start := starts[name]).moment is not None})
        by_clock = clocks.setdefault(size, {})
        for name in names:
            own = round(rates[name].rate, 6) if rates[name].rate > 0.0 else rate
            start = starts[name] if starts[name].moment is not None else Start(moment, starts[name].delay)
            by_clock.setdefault((own, start), []).append(name)
        if not names:
            by_clock[0.0, Start()] = []
    groups: list[Group] = []
    kept: dict[tuple[str, str], Any] = {}
    stamped = len({key[1].moment is None for by_clock in clocks.values() for key in by_clock}) == 1
    for size, by_clock in clocks.items():
        for (rate, start), names in by_clock.items():
            inside = [
                name
                for name, row in rows.items()
                if row.size == size and (name in names or name in times or not names)
            ]
            words = [f"{size} samples"] if len(clocks) > 1 else []
            words += [f"at {rate:.7g} Hz"] if len({key[0] for key in by_clock}) > 1 else []
            if len({key[1] for key in by_clock}) > 1:
                earliest = min(key[1].moment or 0 for key in by_clock)
                words.append(f"from {((start.moment or 0) - earliest) * 1e-9 + start.delay:.7g} s")
            title = " ".join(words)
            of_rate = [rates[name] for name in names or inside if rates[name].rate > 0.0] or [StatedRate()]
            counts = [count for name in inside if (count := known.count(name)) > 0.0]
            spans = [span for name in inside if (span := known.span(name)) > 0.0]
            groups.append(
                Group(
                    title,
                    tuple(channels[name] for name in inside),
                    of_rate[0].rate,
                    start.moment,
                    stamped=stamped and len(by_clock) > 1,
                    source=", ".join(dict.fromkeys(one.source for one in of_rate if one.source)),
                    delay=start.delay,
                    doubt="; ".join(dict.fromkeys(rates[name].doubt for name in inside if rates[name].doubt)),
                    count=counts[0] if counts else math.nan,
                    span=spans[0] if spans else math.nan,
                )
            )
            kept |= {(title, name): rows[name] for name in inside}
    return ArrayTable(path, tuple(groups), kept, settings=known)


def _of_column(name: str, key: str, at: int, count: int, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the settings of an array of several columns state for one of them, by its path."""
    if key == name:
        return {}
    own = {path: value for path, value in settings.items() if path.rpartition("/")[0] == name}
    return {
        f"{key}/{path.rpartition('/')[2]}": np.ravel(value)[at] if np.size(value) == count else value
        for path, value in own.items()
        if np.size(value) in (1, count)
    }


def _channel(name: str, row: Any, units: Mapping[str, str], known: Settings) -> Channel:
    """Return the channel of an array: its unit, and how its numbers become those of the unit."""
    if row.dtype.kind == "M":
        return Channel(name, STAMP, time=True)
    if row.dtype.kind == "m":
        return Channel(name, "ns", time=True)
    unit = units.get(name, "") or known.unit(name) or split_header(name.rpartition("/")[2])[1]
    return Channel(name, unit, scaling=known.scaling(name, whole=row.dtype.kind in "iu"))


def _only(found: set[Any]) -> Any:
    """Return the only one of ``found``, ``None`` where there is none or more."""
    return next(iter(found)) if len(found) == 1 else None


def _rows(name: str, value: Any) -> list[tuple[str, Any]]:
    """Return the rows of an array by name: itself, its fields, or the columns of a matrix."""
    if value.dtype.names:
        return [pair for part in value.dtype.names for pair in _rows(f"{name}/{part}", value[part])]
    value = value.squeeze()
    if value.ndim == 1:
        return [(name, value)]
    if value.ndim != 2:
        return []
    columns = value.T if value.shape[0] >= value.shape[1] else value
    return [(f"{name}/{at}", column) for at, column in enumerate(columns[:MOST_CHANNELS])]
