"""Units of measured channels: what a logger writes, converted by pint; `g` is standard gravity, not gram."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

Array = NDArray[np.float64]

#: All that accelerometers, clocks, displacement and force sensors and thermometers are read in; nothing else
#: is known, so that a gram or a gauss is never met. Gravity: ISO 80000-3.
DEFINITIONS = """
nano- = 1e-9 = n-
micro- = 1e-6 = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
kilo- = 1e3 = k-
mega- = 1e6 = M-
second = [time] = s = sec
minute = 60 * second = min
hour = 3600 * second = h
meter = [length] = m
inch = 0.0254 * meter = in
foot = 0.3048 * meter = ft
standard_gravity = 9.80665 * meter / second ** 2 = g = g_n = gn = G = g0
galileo = 0.01 * meter / second ** 2 = Gal
volt = [voltage] = V
newton = [force] = N
pound_force = 4.4482216152605 * newton = lbf
full_scale = [reading] = FS
kelvin = [temperature]; offset: 0 = K
degree_Celsius = kelvin; offset: 273.15 = degC
degree_Fahrenheit = 5 / 9 * kelvin; offset: 233.15 + 200 / 9 = degF
"""

#: Unit in which each quantity is kept, and the units to choose from where a file names none.
KEPT = {"acceleration": "m/s**2", "time": "s", "temperature": "degC", "length": "m", "force": "N"}

_AS_WRITTEN = {
    "ms-2": "m/s**2", "ms^-2": "m/s**2", "ms**-2": "m/s**2", "mps2": "m/s**2", "mps^2": "m/s**2",
    "m_s2": "m/s**2", "mm_s2": "mm/s**2", "c": "degC", "°c": "degC", "degc": "degC", "°f": "degF",
    "degf": "degF", "msec": "ms", "usec": "us", "sek": "s", "g's": "g", "gee": "g", "volts": "V",
    "seconds": "s",
}  # fmt: skip
_POWERS = str.maketrans({"²": "**2", "³": "**3", "·": "*", "⋅": "*", "×": "*", "µ": "u", "μ": "u", "^": "**"})
_WRITABLE = re.compile(r"[\w\s./*()+-]{1,60}")


@cache
def _registry() -> Any:
    import pint  # noqa: PLC0415 - 0.2 s that nobody else needs

    return pint.UnitRegistry(DEFINITIONS.strip().splitlines(), cache_folder=None)


def normalised(text: str) -> str:
    """Return a unit as pint reads it: of `m/s²`, `[m s^-2]`, `(mV)`."""
    plain = text.strip().strip("[](){}").strip()
    known = _AS_WRITTEN.get(plain.lower())
    if known:
        return known
    plain = plain.replace("⁻²", "**-2").replace("⁻1", "**-1").translate(_POWERS)
    plain = re.sub(r"\b(sec|s)2\b", "s**2", plain)
    plain = re.sub(r"\b(sec|s)-2\b", "s**-2", plain)
    return re.sub(r"(?<=[\w)])\s+(?=[\w(])", "*", plain)


def quantity_of(unit: str) -> str:
    """Return what ``unit`` measures: a key of ``KEPT``, ``voltage``, ``reading``, or "" where not known."""
    plain = normalised(unit)
    if (
        plain == "kg"
        or not plain
        or not _WRITABLE.fullmatch(plain)
        or re.search(r"\*\*\s*-?\d{2}|\d{4}", plain)
    ):
        return ""
    try:
        found = _registry().Unit(plain)
    except Exception:
        return ""
    for quantity, kept in {**KEPT, "voltage": "V", "reading": "FS"}.items():
        if found.dimensionality == _registry().Unit(kept).dimensionality:
            return quantity
    return ""


def converted(values: Array, unit: str, quantity: str) -> Array:
    """Return ``values``, shape (n,), of ``unit`` in the unit in which ``quantity`` is kept.

    Raises:
        InputError: ``unit`` does not measure ``quantity``.
    """
    if quantity_of(unit) != quantity:
        raise InputError(f"{printable(unit, 30)!r} is no unit of {_articled(quantity)}")
    plain = normalised(unit)
    if plain == KEPT[quantity]:
        return values
    if quantity == "temperature":
        return np.asarray(_registry().Quantity(values, plain).to(KEPT[quantity]).magnitude, dtype=np.float64)
    return values * factor(unit, quantity)


def factor(unit: str, quantity: str) -> float:
    """Return by what values of ``unit`` are multiplied for the unit in which ``quantity`` is kept."""
    return float(_registry().Quantity(1.0, normalised(unit)).to(KEPT[quantity]).magnitude)


class Sensitivity:
    """Sensitivity of a sensor, e.g. ``100mV/g``: reading over acceleration.

    Attributes:
        text: as given. reading: unit of the reading, e.g. ``mV``.

    Raises:
        InputError: not a reading over an acceleration.
    """

    def __init__(self, text: str) -> None:
        self.text = text.strip()
        match = re.fullmatch(r"([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)\s*(\S.*)", self.text)
        upper, _, lower = (match[2] if match else "").partition("/")
        size = float(match[1]) if match else 0.0
        inverse = quantity_of(upper + ("/" + lower if lower else "")) == "acceleration"
        if match and inverse:  # 50 m/s^2: of a reading of 1, full scale
            self.reading, self._per_unit = (
                "FS",
                size * factor(f"{upper}/{lower}" if lower else upper, "acceleration"),
            )
            return
        if size and quantity_of(upper) == "acceleration" and quantity_of(lower) in ("voltage", "reading"):
            self.reading, self._per_unit = normalised(lower), size * factor(upper, "acceleration")
            return
        readable = quantity_of(upper) in ("voltage", "reading") and quantity_of(lower) == "acceleration"
        if not size or not readable:
            raise InputError(
                f"{printable(text, 40)!r}: write the sensor's sensitivity like 100mV/g, 10.2mV/(m/s^2), "
                "or 50g/FS for readings from -1 to 1"
            )
        self.reading, self._per_unit = normalised(upper), factor(lower, "acceleration") / size

    def acceleration(self, values: Array, unit: str) -> Array:
        """Return readings of ``unit`` (empty: that of the sensitivity) as accelerations in m/s^2.

        Raises:
            InputError: ``unit`` is not what the sensor gives.
        """
        here = normalised(unit) or self.reading
        if quantity_of(here) != quantity_of(self.reading):
            raise InputError(
                f"it is in {printable(unit, 30)}, a sensitivity of {printable(self.text, 40)} "
                f"is for readings in {self.reading}"
            )
        size = float(_registry().Quantity(1.0, here).to(self.reading).magnitude)
        return values * (size * self._per_unit)


def _articled(quantity: str) -> str:
    return f"an {quantity}" if quantity[0] in "aeiou" else f"a {quantity}"
