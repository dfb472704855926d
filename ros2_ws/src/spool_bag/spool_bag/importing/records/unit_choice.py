"""Units of channels: from the user, from the file, or refused; each conversion is described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.tables.table import STAMP, Channel
from spool_bag.importing.units.header import NO_UNIT
from spool_bag.importing.units.units import KEPT, READINGS, converted, factor, level_of, quantity_of
from spool_bag.tables.column_names import BODY, SPOOL, TIME

from .choices import QUANTITIES, Choices, short, typed
from .roles import Source

Array = NDArray[np.floating]

#: Units to type where a file names none.
_UNITS = {"temperature": "degC", "length": "mm", "force": "N"}
#: Sensitivities to type, by what a sensor puts out.
_EXAMPLES = {
    "voltage": "100mV/g", "reading": "50g/FS", "count": "1.25e-6g/count", "current": "1mA/g",
    "charge": "10pC/g",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class ChannelUse:
    """Use of a channel: which column became what, and the conversion of its values.

    Attributes:
        role: contract name, e.g. ``body_m_s2``.
        file, column, number: file, name of the column there, its number from 0.
        unit: the values' unit, "" where none is known.
        factor: what values are multiplied by; NaN for temperatures with an offset.
        why: option that decides, "" where the file does.
    """

    role: str
    file: str
    column: str
    number: int
    unit: str
    factor: float
    why: str = ""

    def __str__(self) -> str:
        """Column and conversion, for people."""
        kept = KEPT[QUANTITIES[self.role]].replace("**", "^")
        number = f"column #{self.number} " if self.number >= 0 else "column "
        said = f"{short(self.role)}: {number}'{printable(self.column, 60)}'"
        if self.unit == STAMP:
            said += ", dates or times of day"
        elif self.factor == 1.0:
            said += f" in {kept}"
        elif np.isnan(self.factor):
            said += f", {printable(self.unit, 30)} converted to {kept}"
        else:
            said += f", 1 {printable(self.unit, 30)} = {self.factor:.7g} {kept}"
        return said + (f" ({self.why})" if self.why else "")

    def dictionary(self) -> dict[str, Any]:
        """Return the use as JSON has it."""
        known = np.isfinite(self.factor)
        return {
            "role": self.role,
            "file": self.file,
            "column": self.column,
            "number": self.number,
            "unit": None if self.unit in ("", STAMP) else self.unit,
            "factor": self.factor if known else None,
            "option": self.why or None,
        }

    def applied(self, values: Array) -> Array:
        """Return values, shape (n,), in the unit of the role; a row of float32 stays one."""
        if self.factor == 1.0:
            return values
        if np.isnan(self.factor):
            return converted(values.astype(np.float64), self.unit, QUANTITIES[self.role]).astype(values.dtype)
        return (values.astype(np.float64) * self.factor).astype(values.dtype)


class _RefusalError(Exception):
    """Refusal of one channel: why, and what to type for it: alternatives of option and value."""

    def __init__(self, why: str, advice: Sequence[tuple[str, str]], hint: str = "") -> None:
        super().__init__(why)
        self.why, self.advice, self.hint = why, tuple(advice), hint


def uses_of(sources: Mapping[str, Source], asked: Choices) -> dict[str, ChannelUse]:
    """Return how each channel is converted, by role.

    Raises:
        InputError: units that are missing, unknown, or do not fit, with what to type for all of them.
    """
    uses: dict[str, ChannelUse] = {}
    refused: dict[str, _RefusalError] = {}
    for role, one in sources.items():
        try:
            uses[role] = _use_of(role, one, asked)
        except _RefusalError as error:
            refused[role] = error
    if not refused:
        return uses
    first = next(iter(refused.values()))
    alike = [
        role for role, error in refused.items() if (error.why, error.advice) == (first.why, first.advice)
    ]
    path = sources[alike[0]].table.path
    names = " and ".join(sources[role].label for role in alike)
    many = len(alike) > 1
    why = first.why.replace(" has ", " have ", 1).replace(" is ", " are ", 1) if many else first.why
    ways = [typed(option, {short(role): value for role in alike}) for option, value in first.advice]
    raise InputError(f"{path}: {names}{why}: {first.hint}{', or '.join(ways)}")


def use_of_time(path: str, axis: Channel, asked: Choices) -> ChannelUse | None:
    """Return how a time axis is converted to s, ``None`` where the file names no unit of time."""
    unit = asked.units.get(TIME) or axis.unit or ("s" if asked.states_unit(TIME) else "")
    if unit != STAMP and quantity_of(unit) != "time":
        return None
    size = 1.0 if unit == STAMP else factor(unit, "time")
    why = f"--unit time={unit}" if TIME in asked.units else "" if axis.unit else f"--columns {TIME}=..."
    return ChannelUse(TIME, path, axis.header, axis.number, unit, size, why)


def _use_of(role: str, source: Source, asked: Choices) -> ChannelUse:
    channel, quantity, way = source.channel, QUANTITIES[role], short(role)
    own = "" if channel.unit.strip().casefold() in NO_UNIT else channel.unit
    unit = asked.units.get(role) or own
    scale = asked.scales.get(role)
    why = f"--unit {way}={unit}" if role in asked.units else ""
    if why and own and own != unit:
        why += f" instead of the file's {printable(own, 20)}"

    def use(unit: str, size: float, why: str) -> ChannelUse:
        return ChannelUse(role, source.table.path.name, channel.header, channel.number, unit, size, why)

    if scale is not None:
        if role not in (BODY, SPOOL):
            raise InputError(f"--scale {way}: only accelerations have a sensor's sensitivity: leave it out")
        try:
            size = scale.scale(unit)
        except InputError as error:
            reading = scale.reading.replace("percent_full_scale", "%FS").replace("coulomb", "C")
            raise _RefusalError(f": {error}", [("--unit", reading)], "if it is not, type ") from error
        taken = "" if unit else f"no unit in the file, read in {scale.reading}, "
        return use(
            unit or scale.reading, size, f"{taken}--scale {way}={scale.text}" + (f", {why}" if why else "")
        )
    if not unit:
        if asked.states_unit(role):
            return use("", 1.0, f"no unit in the file, --columns {role}=... says it")
        raise _no_unit(quantity)
    found = quantity_of(unit)
    if found == quantity:
        return use(
            unit, float("nan") if found == "temperature" and _shifts(unit) else _factor(unit, quantity), why
        )
    shown = "shares of full scale (FS)" if unit == "FS" else printable(unit, 30)
    if found in READINGS and quantity == "acceleration":
        raise _RefusalError(
            f" is in {shown}", [("--scale", _EXAMPLES[found])], "give the sensor's sensitivity, e.g. "
        )
    raise _wrong_unit(unit, shown, found, quantity)


def _no_unit(quantity: str) -> _RefusalError:
    if quantity != "acceleration":
        return _RefusalError(" has no unit", [("--unit", _UNITS.get(quantity, "s"))], "state it, e.g. ")
    return _RefusalError(
        " has no unit and could be in g, m/s^2, volts or counts",
        [("--unit", "g"), ("--unit", "m/s^2"), ("--scale", "100mV/g"), ("--scale", "1.25e-6g/count")],
        "type ",
    )


def _wrong_unit(unit: str, shown: str, found: str, quantity: str) -> _RefusalError:
    """Return the refusal of a unit that is named, but is not known or measures something else."""
    level = level_of(unit)
    if level and quantity_of(level[0]) == quantity:
        return _RefusalError(
            f" is in {shown}, a statistic ({level[1]}) and not a sample",
            [("--unit", level[0])],
            "export the samples, or if these are instantaneous values type ",
        )
    usual = [
        ("--unit", text) for text in (("g", "m/s^2") if quantity == "acceleration" else (_UNITS[quantity],))
    ]
    if not found:
        return _RefusalError(f" is in {shown}, a unit that is not known", usual, "type the right one, e.g. ")
    return _RefusalError(
        f" is in {shown}, a unit of {found} and not of {quantity}",
        usual[-1:],
        "name another column with --columns, or if the header is wrong type ",
    )


def _shifts(unit: str) -> bool:
    """Return whether a temperature is not in degC."""
    return float(converted(np.zeros(1), unit, "temperature")[0]) != 0.0


def _factor(unit: str, quantity: str) -> float:
    return 1.0 if quantity == "temperature" else factor(unit, quantity)
