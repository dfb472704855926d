"""Unit of a channel: from the user, the file, or refused; what has none could be g, m/s^2 or volts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from spool_bag.tables.column_names import BODY, SPOOL
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.units.units import converted, quantity_of

from .choices import Choices, short
from .roles import QUANTITIES, Source

Array = NDArray[np.floating]

_UNITS = {"temperature": "degC", "length": "mm", "force": "N"}


def in_kept_unit(path: Path, role: str, source: Source, values: Array, asked: Choices) -> tuple[Array, str]:
    """Return a channel's values in the unit of its role, and how it was understood, "" where it is plain.

    Raises:
        InputError: no unit is known, or it does not fit; the line to type is said.
    """
    kind = values.dtype
    unit = asked.units.get(role) or source.channel.unit
    scale = asked.scales.get(role)
    name, way = source.label, short(role)
    if scale is not None:
        if role not in (BODY, SPOOL):
            raise InputError(f"--scale {way}: only accelerations are read by a sensor's sensitivity")
        note = (
            "" if unit else f"{name} has no unit: read in {scale.reading}, as --scale {way}={scale.text} says"
        )
        try:
            return scale.acceleration(values.astype(np.float64), unit).astype(kind), note
        except InputError as error:
            raise InputError(f"{path}: {name}: {error}") from error
    quantity = QUANTITIES[role]
    if not unit:
        if asked.states_unit(role):
            return values, f"{name} has no unit: taken as --columns {role} says"
        raise InputError(f"{path}: {_unknown(role, name)}")
    found = quantity_of(unit)
    if found in ("voltage", "reading") and quantity == "acceleration":
        example = "100mV/g" if found == "voltage" else "50g/FS"
        raise InputError(
            f"{path}: {name} is in {_said(unit)}: give the sensor's sensitivity with --scale {way}={example}"
        )
    if found != quantity:
        raise InputError(
            f"{path}: {name} is in {_said(unit)}, which is no {quantity}: name another channel with "
            f"--columns {role}=NAME, or its true unit with --unit {way}={_UNITS.get(quantity, 'g')}"
        )
    return converted(np.asarray(values), unit, quantity).astype(kind, copy=False), ""


def _said(unit: str) -> str:
    return "shares of full scale (FS)" if unit == "FS" else printable(unit, 30)


def _unknown(role: str, name: str) -> str:
    way = short(role)
    if QUANTITIES[role] != "acceleration":
        return f"{name} has no unit: say it with --unit {way}={_UNITS.get(QUANTITIES[role], 's')}"
    return (
        f"{name} has no unit and could be in g, m/s^2 or volts: type --unit {way}=g, or --unit "
        f"{way}=m/s^2, or "
        f"--scale {way}=100mV/g for a sensor's voltage"
    )
