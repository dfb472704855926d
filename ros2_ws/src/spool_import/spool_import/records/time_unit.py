"""Unit of a time axis: from its header, from the choice of a user, or where only one is plausible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_bag.tables.column_names import TIME
from spool_stream.block_gate import SHORTEST_PERIOD
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.tables.table import Channel
from spool_import.units.units import factor, quantity_of

from .choices import Choices

#: s: at 20 Hz not even 10 Hz can be seen, below any spool valve's natural frequency.
LONGEST_USUAL_PERIOD = 0.05
#: s, of a force record, which may be as slow as its machine.
LONGEST_PERIOD = 10.0
#: s: 100 kHz is beyond what accelerometers of valves are sampled with.
SHORTEST_USUAL_PERIOD = 1e-5
#: s since 1970: from 2001 to 2038; numbers of that size in some unit count from 1970.
CALENDAR = (1e9, 2.0**31)

_SIZES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_NAMES = {
    "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0,
}  # fmt: skip

Array = NDArray[np.float64]


def time_in_seconds(path: Path, axis: Channel, values: Array, asked: Choices) -> tuple[Array, str]:
    """Return times in s, and how an unnamed unit was understood.

    Raises:
        InputError: the unit is no time, or several are plausible.
    """
    unit = asked.units.get(TIME) or axis.unit or ("s" if asked.states_unit(TIME) else "")
    if unit:
        if quantity_of(unit) != "time":
            raise InputError(
                f"{path}: {printable(axis.name, 40)} is in {printable(unit, 30)}, which is no time"
            )
        size = factor(unit, "time")
        return (values if size == 1.0 else values * size), ""
    found = _plausible(values)
    if len(found) != 1:
        way = "s" if "s" in found or not found else found[0]
        kinds = " or ".join(found or list(_SIZES))
        raise InputError(
            f"{path}: {printable(axis.name, 40)} has no unit and could be in {kinds}: say which with "
            f"--unit time={way}"
        )
    only = found[0]
    note = f"{printable(axis.name, 40)} has no unit: by its steps and size it is in {only}"
    return (values if only == "s" else values * _SIZES[only]), note


def _plausible(values: Array) -> list[str]:
    """Return the units in which times count from 1970, or else in which their steps are a usual period."""
    if values.size < 3:
        return ["s"]
    first = float(values[0])
    calendar = [unit for unit, size in _SIZES.items() if CALENDAR[0] < first * size < CALENDAR[1]]
    step = float(np.median(np.diff(values[: 1 << 16])))
    if calendar:
        fitting = [unit for unit in calendar if step * _SIZES[unit] <= LONGEST_PERIOD]
        return fitting or calendar
    return [
        unit for unit, size in _SIZES.items() if SHORTEST_USUAL_PERIOD <= step * size <= LONGEST_USUAL_PERIOD
    ]


def period_check(path: Path, name: str, period: float, kind: str) -> str:
    """Return what is odd about a sampling period (s), "" where nothing is.

    Raises:
        InputError: the time is hardly in s: an error by 1000 would go through every number.
    """
    name = printable(name, 40)
    slowest = LONGEST_USUAL_PERIOD if kind == "accelerations" else LONGEST_PERIOD
    if not SHORTEST_PERIOD <= period <= slowest:
        raise InputError(
            f"{path}: {name} steps by {period:g} s: are these {_usual(period)}? give the unit with "
            "--unit time=ms, "
            f"and the samples of a valve at more than {1.0 / LONGEST_USUAL_PERIOD:g} Hz"
        )
    return (
        f"{name} steps by {period:g} s: are these {_usual(period)}?" if period > LONGEST_USUAL_PERIOD else ""
    )


def _usual(period: float) -> str:
    """Return the unit in which ``period`` would be plausible."""
    plausible = [unit for unit, size in _NAMES.items() if 1e-5 <= period * size <= LONGEST_USUAL_PERIOD]
    return plausible[0] if plausible else "seconds"
