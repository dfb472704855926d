"""ASAM MDF 3 and 4, as measuring systems of vehicles and mobile machines write it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import Channel, Group, Table, Values, as_numbers, check_size
from spool_bag.importing.units import split_header

_TIME = "time of the group"
#: What a group's values may be over instead of time, by the code of its master (MDF 4.1, cn_sync_type).
_OVER = {2: "an angle", 3: "a distance", 4: "an index"}


class Mf4Table(Table):
    """MDF file: each of its channel groups has its own clock; values that it marks as invalid are NaN."""

    holes_are_gaps = True
    zoned = True

    def __init__(self, path: Path) -> None:
        check_size(path)
        self.path = path
        with _opened(path) as file:
            begun = round(file.header.start_time.timestamp() * 1e9)
            stated = {"comment": str(getattr(file.header, "description", "") or "")}
            groups = []
            held_groups: Any = file.groups
            for at, group in enumerate(held_groups):
                master = file.masters_db.get(at)
                axis: Any = None if master is None else group.channels[master]
                over = _OVER.get(int(getattr(axis, "sync_type", 0) or 0), "")
                if over:
                    why = f"over {over} ({printable(axis.name, 40)}), not over time"
                    self.unread = {**self.unread, **{one.name: why for one in group.channels}}
                    continue
                channels = [
                    Channel(
                        one.name,
                        str(one.unit or getattr(one.conversion, "unit", "") or "")
                        or split_header(one.name)[1],
                    )
                    for number, one in enumerate(group.channels)
                    if number != master
                ]
                stated |= {f"{one.name}/comment": str(one.comment or "") for one in group.channels}
                of_group = str(getattr(group.channel_group, "comment", "") or "")
                stated |= {f"comment of {channels[0].name}": of_group} if channels else {}
                name = "" if len(file.groups) == 1 else str(at)
                held = (Channel(_TIME, "s", time=True), *channels) if master is not None else tuple(channels)
                groups.append(Group(name, held, start=begun, stamped=True))
        self.settings = Settings({key: text for key, text in stated.items() if text.strip()})
        self.groups = tuple(group for group in groups if len(group.channels) > 1)
        if not self.groups and self.unread:
            name, why = next(iter(self.unread.items()))
            raise InputError(f"{path}: {printable(name, 40)} is {why}: export signals over time")
        self._index = {group.name: int(group.name or 0) for group in self.groups}

    def read(self, group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of channels by name."""
        found: dict[str, Values] = {}
        at = self._index[group.name]
        with _opened(self.path) as file:
            for name in names:
                if name == _TIME:
                    found[name] = np.asarray(file.get_master(at), dtype=np.float64)
                    continue
                signal = file.get(name, group=at, ignore_invalidation_bits=True)
                found[name] = as_numbers(self.path, name, signal.samples)
                if signal.invalidation_bits is not None and np.any(signal.invalidation_bits):
                    bits = np.asarray(signal.invalidation_bits, dtype=np.bool_)
                    found[name] = np.where(bits, math.nan, found[name].astype(np.float64))
        return found


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file.

    Raises:
        InputError: it is cut off or was never finished, which its library meets in many ways.
    """
    from asammdf import MDF  # noqa: PLC0415 - comes with the extras
    from asammdf.blocks.mdf_v4 import MDF4  # noqa: PLC0415

    MDF4.__del__ = _closed  # type: ignore[method-assign]  # asammdf 8.1 writes tracebacks about files that it could not open
    try:
        file = MDF(path)
    except Exception as error:
        raise InputError(
            f"{path}: it cannot be read as ASAM MDF ({type(error).__name__}): it is cut off, or the logger "
            "never finished it: copy it again, or let the logger's software repair it"
        ) from error
    with file:
        yield file


def _closed(file: Any) -> None:
    with suppress(AttributeError):
        file.close()


FORMAT = Format(
    "ASAM MDF",
    (".mf4", ".mdf", ".dat"),
    Mf4Table,
    begins=(b"MDF     ", b"UnFinMF "),
    library=("asammdf", "asammdf"),
)
