"""Universal files, dataset 58: functions over time as analysers of vibration write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import ArrayTable, Channel, Group, check_size
from spool_bag.importing.units import factor, quantity_of, split_header

#: Abscissa that is time, by the codes of dataset 58, record 8; and what an unevenly spaced one is called.
_TIME, _ABSCISSA = 17, "abscissa"
#: Texts of a dataset that nothing is made of.
_TEXTS = ("id2", "id3", "id4", "id5", "ordinate_axis_lab")
#: Dataset of units.
UNITS = 164
#: Functions that are signals: unknown ones and time responses, record 6.
_SIGNALS = (0, 1)
#: Quantities of data by their code, record 9; those of 0 and 1 are not stated.
_QUANTITIES = {
    2: "stress", 3: "strain", 5: "temperature", 8: "displacement", 9: "force", 11: "velocity",
    12: "acceleration", 13: "force", 15: "pressure",
}  # fmt: skip

_Clock = tuple[float, float, int, bytes]


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
    clocks: dict[_Clock, list[tuple[Channel, Any]]] = {}
    times: dict[_Clock, Any] = {}
    other: dict[str, str] = {}
    stated: dict[str, str] = {}
    directions: dict[str, int] = {}
    units = [file.read_sets(at) for at, kind in enumerate(kinds) if kind == UNITS]
    if units and int(units[0].get("units_code", 1)) != 1:
        stated["dataset 164"] = f"units of code {int(units[0]['units_code'])}"
    for number, one in enumerate(sets):
        if np.iscomplexobj(one["data"]):
            continue
        name = _text(one, "id1") or f"node {one.get('rsp_node', number)}"
        why = _no_signal(one)
        if why:
            other[name] = why
            continue
        clock, x = _clock(one)
        times[clock] = x
        held = clocks.setdefault(clock, [])
        taken = {channel.name for channel, _ in held}
        unique = name if name not in taken else f"{name} {number}"
        unit = _text(one, "ordinate_axis_units_lab") or split_header(name)[1]
        stated |= {f"{unique}/{key}": text for key, text in _stated(one, unit).items()}
        directions[unique] = int(one.get("rsp_dir", 0))
        held.append((Channel(unique, unit), np.asarray(one["data"])))
    if not clocks:
        listed = ", ".join(f"{name} {why}" for name, why in list(other.items())[:6])
        held_sets = listed or f"datasets {sorted(set(kinds))}"
        raise InputError(
            f"{path}: no function over time (dataset 58) in it; it has {printable(held_sets, 200)}: export "
            "time signals"
        )
    if len(set(directions.values())) > 1:  # a sign or an axis that is another channel's
        stated |= {f"{name}/rsp_dir": str(one) for name, one in directions.items()}
    groups: list[Group] = []
    arrays: dict[tuple[str, str], Any] = {}
    for at, (clock, held) in enumerate(clocks.items()):
        step, begin, _, _ = clock
        name = "" if len(clocks) == 1 else f"clock {at + 1}"
        channels = tuple(channel for channel, _ in held)
        if step <= 0.0:
            channels = (Channel(_ABSCISSA, "s", time=True), *channels)
            arrays[name, _ABSCISSA] = times[clock]
        rate, source = (1.0 / step, "abscissa increment") if step > 0.0 else (math.nan, "")
        # Abscissas of one file count from one moment.
        groups.append(Group(name, channels, rate, stamped=True, source=source, delay=begin))
        arrays |= {(name, channel.name): values for channel, values in held}
    return ArrayTable(path, tuple(groups), arrays, settings=Settings(stated), unread=other)


def _no_signal(one: Mapping[str, Any]) -> str:
    """Return why a dataset is no signal over time, "" where it is one."""
    axis, code = _text(one, "abscissa_axis_units_lab"), int(one.get("abscissa_spec_data_type", _TIME))
    if code not in (0, _TIME) or (axis and quantity_of(axis) != "time"):
        return f"over {axis or f'data of type {code}'}"
    function = int(one.get("func_type", 1))
    return "" if function in _SIGNALS else f"of function type {function}"


def _clock(one: Mapping[str, Any]) -> tuple[_Clock, Any]:
    """Return step (s, 0 where it varies), begin (s) and number of samples of a dataset, and its times."""
    axis = _text(one, "abscissa_axis_units_lab")
    size = factor(axis, "time") if axis else 1.0
    step = size * float(one.get("abscissa_inc", 0.0) or 0.0)
    uneven = int(one.get("abscissa_spacing", 1)) == 0 or step <= 0.0
    x = size * np.asarray(one["x"], dtype=np.float64) if uneven else np.empty(0)
    begin = 0.0 if uneven else size * float(one.get("abscissa_min", 0.0) or 0.0)
    return (0.0 if uneven else step, begin, np.size(one["data"]), x.tobytes()), x


def _stated(one: Mapping[str, Any], unit: str) -> dict[str, str]:
    """Return what a dataset states that nothing uses, by its name."""
    found = {key: text for key in _TEXTS if (text := _text(one, key))}
    kind = _QUANTITIES.get(int(one.get("ordinate_spec_data_type", 0)), "")
    if kind and quantity_of(unit) not in ("", {"displacement": "length"}.get(kind, kind)):
        found["kind of data"] = kind
    if float(one.get("z_axis_value", 0.0) or 0.0):
        found["z_axis_value"] = f"{one['z_axis_value']:.7g}"
    return found


def _text(one: Mapping[str, Any], key: str) -> str:
    """Return a text of a dataset, "" for none, which the format writes as NONE."""
    text = str(one.get(key, "")).strip()
    return "" if text.upper() == "NONE" else text


FORMAT = Format(
    "UFF 58",
    (".uff", ".unv", ".58"),
    opened,
    begins=(b"    -1\n", b"    -1\r\n", b"    -1 "),
    library=("pyuff", "pyuff"),
)
