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

#: Names of a number that states a sampling rate (+1) or a period (-1), and of one that may as well be the
#: speed of a shaft or an excitation's; `_Hz`, `_kHz`, `_s`, `_ms`, `_us` may follow.
_RATES = dict.fromkeys(
    (
        "fs", "f_s", "sr", "samplerate", "sample_rate", "samplingrate", "sampling_rate", "samp_rate",
        "fsample", "f_sample", "samplefrequency", "sample_frequency", "samplingfrequency",
        "sampling_frequency",
        "sampling_freq", "sample_freq", "samples_per_second", "abtastrate", "abtastfrequenz",
    ),
    1.0,
)  # fmt: skip
_PERIODS = dict.fromkeys(
    (
        "dt", "ts", "t_s", "delta_t", "deltat", "sampleperiod", "sample_period", "samplingperiod",
        "sampling_period", "sampleinterval", "sample_interval", "samplinginterval", "sampling_interval",
        "sampletime", "sample_time", "time_step", "timestep", "abtastzeit",
    ),
    -1.0,
)  # fmt: skip
_SURE = {**_RATES, **_PERIODS}
_DOUBTFUL = {"rate": 1.0, "frequency": 1.0, "freq": 1.0, "period": -1.0}
_SUFFIXES = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
#: Relative difference up to which two settings are one rate.
_SAME = 1e-6
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
    there.
    """

    name: str
    unit: str = ""
    time: bool = False
    role: str = ""
    dated: bool = True
    number: int = -1
    own: str = ""

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
    rate or not.
    """

    name: str
    channels: tuple[Channel, ...]
    rate: float = math.nan
    start: int | None = None
    stamped: bool = False
    source: str = ""
    delay: float = 0.0
    doubt: str = ""

    def channel(self, name: str) -> Channel:
        """Return the channel that has ``name``."""
        return next(one for one in self.channels if one.name == name)


class Table(ABC):
    """What a file holds.

    ``notes``: how it was understood, ``warnings``: what is wrong with it, one line each; ``warnings`` are
    complete only after :meth:`read`. ``clocks``: of bags, header stamps and times of reception (ns, int64,
    shape (n,)) of each group that was read. ``holes_are_gaps``: rows without a value are missing samples by
    the format. ``dates``: order of day and month, ``dmy`` or ``mdy``, where the user states it. ``gravity``:
    length of the mean vector of three axes, in the unit that the format prescribes, by group, once read.
    """

    path: Path
    groups: tuple[Group, ...]
    clocks: Mapping[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = MappingProxyType({})
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    holes_are_gaps: bool = False
    dates: str = ""
    gravity: Mapping[str, float] = MappingProxyType({})

    def account(self, title: str, what: str, stated: float | None, read: float) -> None:
        """Warn where the file states another amount of something than was read, e.g. of messages."""
        if stated and abs(read - stated) > COUNTED_ALIKE * stated:
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


@dataclass(frozen=True, slots=True)
class StatedRate:
    """Rate (Hz) that a setting states for a channel, NaN for none; ``source``: the settings' own names.

    ``doubt``: why none is taken though there are settings, with what to type.
    """

    rate: float = math.nan
    source: str = ""
    doubt: str = ""


def stated_rate(channel: str, settings: Mapping[str, Any]) -> StatedRate:
    """Return the rate that holds for a channel: of the settings nearest to it, else of those elsewhere.

    Args:
        channel: its path, e.g. ``bearing/gs``; settings on the way to it are beside it.
        settings: numbers by their paths, e.g. ``bearing/sr``.
    """
    sure: list[tuple[int, str, float]] = []
    doubtful: list[str] = []
    for path, value in settings.items():
        parent, _, name = path.rpartition("/")
        number = _positive(value)
        plain = name.lower().strip().replace(" ", "_")
        if number is None:
            continue
        power, size = _rate_name(plain, _SURE)
        beside = not parent or channel == parent or channel.startswith(f"{parent}/")
        if power:
            depth = (0 if not parent else 1 + parent.count("/")) if beside else -1
            sure.append((depth, path, float((number * size) ** power)))
        elif _rate_name(plain, _DOUBTFUL)[0] and beside:
            doubtful.append(f"{printable(path, 60)} = {number:.7g}")
    if not sure:
        may_be = f"{' and '.join(doubtful)} may be a sampling rate or not: if it is, type it with --rate"
        return StatedRate(doubt=may_be if doubtful else "")
    nearest = max(depth for depth, _, _ in sure)
    taken = [(path, rate) for depth, path, rate in sure if depth == nearest]
    rate = taken[0][1]
    if any(abs(other / rate - 1.0) > _SAME for _, other in taken):
        said = " and ".join(f"{printable(path, 60)} = {one:.7g} Hz" for path, one in taken[:4])
        return StatedRate(doubt=f"{said} disagree: type the right one, e.g. --rate {rate:.7g}")
    name = taken[0][0].rpartition("/")[2]
    return StatedRate(rate, printable(" and ".join(path for path, _ in taken[:3]), 120) or name)


def array_table(
    path: Path,
    arrays: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> ArrayTable:
    """Return the table of named arrays: those of one length share a clock.

    Args:
        path: of the file.
        arrays: rows, and matrices whose columns are channels, or whose rows are where these are longer.
        units: by the arrays' names, where the file states them.
        settings: numbers by their paths; arrays of one number are settings as well.

    Raises:
        InputError: there is no row of numbers.
    """
    rows: dict[str, Any] = {}
    for name, value in arrays.items():
        for key, row in _rows(name, np.asarray(value)):
            if row.size >= SHORTEST and row.dtype.kind in "fiubM":
                rows[key] = row
    if not rows:
        raise InputError(f"{path}: no row of at least {SHORTEST} numbers in it")
    if len(rows) > MOST_CHANNELS:
        raise InputError(f"{path}: {len(rows)} channels, more than {MOST_CHANNELS}")
    known = {**(settings or {}), **{key: value for key, value in arrays.items() if np.size(value) == 1}}
    by_size: dict[int, list[str]] = {}
    for name, row in rows.items():
        by_size.setdefault(row.size, []).append(name)
    groups: list[Group] = []
    kept: dict[tuple[str, str], Any] = {}
    for size, names in by_size.items():
        channels = {
            name: Channel(
                name,
                STAMP if dated else (units or {}).get(name, "") or split_header(name.rpartition("/")[2])[1],
                time=dated,
            )
            for name in names
            for dated in [rows[name].dtype.kind == "M"]
        }
        stated = {name: stated_rate(name, known) for name in names}
        rates = {
            round(one.rate, 6): one
            for name, one in stated.items()
            if one.rate > 0.0 and not _is_time(channels[name])
        }
        for rate in rates or {0.0: StatedRate()}:
            inside = [
                name
                for name in names
                if len(rates) < 2 or round(stated[name].rate, 6) == rate or _is_time(channels[name])
            ]
            title = f"{size} samples" if len(by_size) > 1 else ""
            title += f"{' ' if title else ''}at {rate:.7g} Hz" if len(rates) > 1 else ""
            of_rate = [stated[name] for name in inside if round(stated[name].rate, 6) == rate]
            sources = dict.fromkeys(one.source for one in of_rate)
            doubts = dict.fromkeys(stated[name].doubt for name in inside if stated[name].doubt)
            groups.append(
                Group(
                    title,
                    tuple(channels[name] for name in inside),
                    of_rate[0].rate if of_rate else math.nan,
                    source=", ".join(sources),
                    doubt="; ".join(doubts),
                )
            )
            kept |= {(title, name): rows[name] for name in inside}
    return ArrayTable(path, tuple(groups), kept)


def _rate_name(name: str, known: Mapping[str, float]) -> tuple[float, float]:
    """Return 1 for a rate's name, -1 for a period's, 0 for others, and the size of the unit in it."""
    if name in known:
        return known[name], 1.0
    base, _, suffix = name.rpartition("_")
    power, size = known.get(base, 0.0), _SUFFIXES.get(suffix, 0.0)
    return (power, size) if power and size and ("hz" in suffix) == (power > 0.0) else (0.0, 1.0)


def _positive(value: Any) -> float | None:
    """Return a setting as a number above 0, ``None`` for others."""
    try:
        held = np.asarray(value).reshape(-1)
        number = float(held[0]) if held.size == 1 else math.nan
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) and number > 0.0 else None


def _is_time(channel: Channel) -> bool:
    """Return whether a channel may be a time axis, which all channels of its length share."""
    return (
        channel.time
        or quantity_of(channel.unit) == "time"
        or channel.name.rpartition("/")[2].lower() in TIMES
    )


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
