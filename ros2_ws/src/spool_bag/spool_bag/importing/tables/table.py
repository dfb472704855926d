"""Table of a logger's file: groups of channels, each group on one clock."""

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
    """Table: what a file holds.

    ``notes``: how it was understood, ``warnings``: what is wrong with it, one line each; ``warnings`` are
    complete only after :meth:`read`. ``clocks``: of bags, header stamps and times of reception (ns, int64,
    shape (n,)) of each group that was read. ``holes_are_gaps``: rows without a value are missing samples by
    the format. ``dates``: order of day and month, ``dmy`` or ``mdy``, where the user states it.
    """

    path: Path
    groups: tuple[Group, ...]
    clocks: Mapping[str, tuple[NDArray[np.int64], NDArray[np.int64]]] = MappingProxyType({})
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    holes_are_gaps: bool = False
    dates: str = ""

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
    """Return names of which none is there twice: those that were get an index from 1."""
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
