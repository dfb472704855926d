"""Universal files, dataset 58: functions over time as analysers of vibration write them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from spool_stream.errors import InputError

from spool_import.tables.table import ArrayTable, Channel, Group, check_size
from spool_import.units.header import split_header

from .format import Format

#: Abscissa that is time, and ordinate that is acceleration, by the codes of dataset 58, records 8 and 9.
_TIME, _ACCELERATION = 17, 12


def opened(path: Path) -> ArrayTable:
    """Return the time functions of a file: each a channel, with its unit and spacing.

    Raises:
        InputError: it has none.
    """
    import pyuff  # noqa: PLC0415 - comes with the extras

    check_size(path)
    file = pyuff.UFF(str(path))
    kinds = [int(kind) for kind in file.get_set_types()]
    sets = [file.read_sets(at) for at, kind in enumerate(kinds) if kind == 58]
    clocks: dict[tuple[float, int], list[tuple[Channel, Any]]] = {}
    for number, one in enumerate(sets):
        if int(one.get("abscissa_spec_data_type", _TIME)) not in (0, _TIME) or np.iscomplexobj(one["data"]):
            continue
        name = str(one.get("id1", "")).strip()
        name = name if name and name.upper() != "NONE" else f"node {one.get('rsp_node', number)}"
        unit = str(one.get("ordinate_axis_units_lab", "")).strip()
        unit = "" if unit.upper() == "NONE" else unit
        step = float(one.get("abscissa_inc", 0.0) or 0.0)
        if step <= 0.0:
            step = float(np.median(np.diff(one["x"]))) if np.size(one["x"]) > 1 else math.nan
        held = clocks.setdefault((step, np.size(one["data"])), [])
        taken = {channel.name for channel, _ in held}
        unique = name if name not in taken else f"{name} {number}"
        held.append((Channel(unique, unit or split_header(name)[1]), np.asarray(one["data"])))
    if not clocks:
        raise InputError(
            f"{path}: no function over time (dataset 58) in it; it has datasets {sorted(set(kinds))}"
        )
    groups: list[Group] = []
    arrays: dict[tuple[str, str], Any] = {}
    for at, ((step, _), held) in enumerate(clocks.items()):
        name = "" if len(clocks) == 1 else f"clock {at + 1}"
        groups.append(Group(name, tuple(channel for channel, _ in held), 1.0 / step))
        arrays |= {(name, channel.name): values for channel, values in held}
    return ArrayTable(path, tuple(groups), arrays)


FORMAT = Format(
    "UFF 58",
    (".uff", ".unv", ".58"),
    opened,
    begins=(b"    -1\n", b"    -1\r\n", b"    -1 "),
    library=("pyuff", "pyuff"),
)
