"""NI TDMS, as LabVIEW writes it: channels as `group/channel`, units and waveform timing from properties."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import STAMP, Channel, Group, Table, Values, as_numbers
from spool_bag.importing.units import factor, quantity_of, split_header

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit", "units")


class TdmsTable(Table):
    """TDMS file; a channel is read when it is asked for."""

    zoned = True

    def __init__(self, path: Path) -> None:
        from nptdms import TdmsFile  # noqa: PLC0415 - comes with the extras
        from nptdms.log import log_manager  # noqa: PLC0415

        self.path = path
        self._channels: dict[tuple[str, str], Any] = {}
        clocks: dict[tuple[float, int | None, float, int], list[Channel]] = {}
        self._shortest = 0
        # The library has its own words about a file that is cut off.
        log_manager.set_level(logging.CRITICAL)
        with TdmsFile.read_metadata(path) as file:
            stated = dict(file.properties)
            for group in file.groups():
                stated |= {f"{group.name}/{key}": value for key, value in group.properties.items()}
            every = [channel for group in file.groups() for channel in group.channels()]
            held = [channel for channel in every if len(channel)]
            if file.file_status.incomplete_final_segment:
                self._cut(held, [channel for channel in every if not len(channel)])
            for channel in every:
                name = f"{channel.group_name}/{channel.name}"
                stated |= {f"{name}/{key}": value for key, value in channel.properties.items()}
        known = self.settings = Settings(stated)
        placed = False
        for channel in held:
            found = channel.properties
            name = f"{channel.group_name}/{channel.name}"
            known.use(*(f"{name}/{key}" for key in found if key in _UNITS or key.startswith(("wf_", "NI_"))))
            unit = next((str(found[key]) for key in _UNITS if found.get(key)), "")
            unit = unit or known.unit(name) or split_header(channel.name)[1]
            step = float(found.get("wf_increment", math.nan) or math.nan)
            axis = str(found.get("wf_xunit_string") or "").strip()
            if axis and step > 0.0:  # a waveform may be over degrees or hertz
                step = step * factor(axis, "time") if quantity_of(axis) == "time" else math.nan
            start = found.get("wf_start_time")
            begun = None if start is None else int(np.datetime64(start, "ns").astype(np.int64))
            delay = float(found.get("wf_start_offset", 0.0) or 0.0)
            if not step > 0.0:
                step = 1.0 / known.rate(name).rate
            if start is None and delay == 0.0:
                begun, delay = known.start(name)
            placed |= (begun or 0) > 0 or delay != 0.0
            dated = channel.dtype.kind == "M"
            clock = (step if step > 0.0 else -1.0, begun, delay, self._shortest or len(channel))
            clocks.setdefault(clock, []).append(
                Channel(
                    name,
                    STAMP if dated else unit,
                    time=dated,
                    scaling=known.scaling(name, whole=channel.dtype.kind in "iu"),
                )
            )
        groups = []
        for at, ((step, begun, delay, _), channels) in enumerate(clocks.items()):
            title = "" if len(clocks) == 1 else f"clock {at + 1}"
            first = channels[0].name
            of_rate = known.rate(first)
            groups.append(
                replace(
                    Group.stated(title, channels, known, of_rate, first),
                    rate=1.0 / step if step > 0.0 else math.nan,
                    start=begun if begun and begun > 0 else None,
                    stamped=placed and step > 0.0 and len({one[1] is None for one in clocks}) == 1,
                    source=of_rate.source or "wf_increment" if step > 0.0 else "",
                    delay=delay,
                )
            )
        self.groups = tuple(groups)

    def _cut(self, held: Sequence[Any], missing: Sequence[Any]) -> None:
        """Note that the file is cut off: all channels end with the shortest one.

        Raises:
            InputError: a channel has no samples.
        """
        if missing or not held:
            names = ", ".join(printable(one.name, 40) for one in missing[:4]) or "all channels"
            raise InputError(
                f"{self.path}: the file is cut off: no samples of {names} are left: copy it again"
            )
        self._shortest = min(len(one) for one in held)
        self.warnings = (
            f"the file is cut off: the {self._shortest} samples that all channels have are read",
        )

    def read(self, _group: Group, names: Sequence[str], _single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of channels by name."""
        from nptdms import TdmsFile  # noqa: PLC0415

        found: dict[str, Values] = {}
        with TdmsFile.open(self.path) as file:
            for name in names:
                part, _, channel = name.partition("/")
                found[name] = as_numbers(self.path, name, file[part][channel][: self._shortest or None])
        return found


FORMAT = Format("NI TDMS", (".tdms",), TdmsTable, begins=(b"TDSm",), library=("npTDMS", "nptdms"))
