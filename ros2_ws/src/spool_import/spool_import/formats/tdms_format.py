"""NI TDMS, as LabVIEW writes it: channels as `group/channel`, units and waveform timing from properties."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spool_import.tables.table import STAMP, Channel, Group, Table, Values, as_numbers

from .format import Format

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit", "units")


class TdmsTable(Table):
    """TDMS file; a channel is read when it is asked for."""

    def __init__(self, path: Path) -> None:
        from nptdms import TdmsFile  # noqa: PLC0415 - comes with the extras

        self.path = path
        self._channels: dict[tuple[str, str], Any] = {}
        clocks: dict[tuple[float, int | None, int], list[Channel]] = {}
        with TdmsFile.read_metadata(path) as file:
            held = [channel for group in file.groups() for channel in group.channels() if len(channel)]
        for channel in held:
            unit = next((str(channel.properties[key]) for key in _UNITS if channel.properties.get(key)), "")
            step = float(channel.properties.get("wf_increment", math.nan) or math.nan)
            start = channel.properties.get("wf_start_time")
            begun = None if start is None else int(np.datetime64(start, "ns").astype(np.int64))
            dated = channel.dtype.kind == "M"
            name = f"{channel.group_name}/{channel.name}"
            clock = (step if step > 0.0 else -1.0, begun, len(channel))
            clocks.setdefault(clock, []).append(Channel(name, STAMP if dated else unit, time=dated))
        groups = []
        for at, ((step, begun, _), channels) in enumerate(clocks.items()):
            name = "" if len(clocks) == 1 else f"clock {at + 1}"
            rate = 1.0 / step if step > 0.0 else math.nan
            groups.append(Group(name, tuple(channels), rate, begun if begun and begun > 0 else None))
        self.groups = tuple(groups)

    def read(self, _group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of channels by name."""
        from nptdms import TdmsFile  # noqa: PLC0415

        found: dict[str, Values] = {}
        with TdmsFile.open(self.path) as file:
            for name in names:
                part, _, channel = name.partition("/")
                found[name] = as_numbers(self.path, name, file[part][channel][:])
        return found


FORMAT = Format("NI TDMS", (".tdms",), TdmsTable, begins=(b"TDSm",), library=("npTDMS", "nptdms"))
