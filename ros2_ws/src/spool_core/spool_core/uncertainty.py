"""Quantities with units and intervals, how many of their digits are shown, and results as JSON."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from decimal import ROUND_CEILING, ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from pathlib import PurePath
from typing import Any

#: Quantile of the standard normal distribution for a two-sided 95 % interval (NIST handbook 1.3.6.7.1).
#: Not Student's t: what is shown comes from hundreds of samples and more, and t of 60 degrees of freedom
#: is 2.00, which the two digits shown hardly tell from 1.96.
Z_95 = 1.96

#: Powers of the sampling rate in units of what two accelerometers show: a velocity is an acceleration over
#: the rate, a displacement over its square; forces are measured as accelerations of a known mass. A viscosity
#: is a drag over known lengths.
_RATE_POWERS = {"m": -2, "s": -1, "Hz": 1, "Pa s": 1}
#: Heading of a column of half widths, and what it means.
PLUS_MINUS = "± 95 %"
LEGEND = "± 95 %: half width of the 95 % interval, 1.96 standard deviations"

#: What is shown of a number that is not known.
UNKNOWN = "unknown"

#: Decimal exponents of numbers that are written without a power of ten: 0.0001 to below 10 000 000.
_PLAIN = range(-4, 7)

#: Significant digits that a double holds for sure (DBL_DIG of C).
_DOUBLE = 15

#: Significant digits of a number without any interval.
_DIGITS = 4

#: Metadata of a dataclass's field that JSON leaves out, and of one whose entries it writes by their names.
LEFT_OUT, BY_NAME = {"left_out": True}, {"by_name": True}
#: Metadata of a field that JSON writes as null where it is empty.
EMPTY_IS_NULL = {"empty_is_null": True}


@dataclass(frozen=True, slots=True)
class Shown:
    """Number and half width of its 95 % interval as they are shown, with the same last digit.

    ``half_width`` is ``unknown`` where there is none; both are where the number itself is not known.
    """

    value: str
    half_width: str

    def __str__(self) -> str:
        return self.value if self.value == UNKNOWN else f"{self.value} ± {self.half_width}"


def interval(value: float | None, standard_deviation: float | None) -> Shown:
    """Return the 95 % interval; the half width's two significant digits decide what is shown of both.

    ``None``, as JSON has it, is not known either.
    """
    pair = [math.nan if one is None else one for one in (value, standard_deviation)]
    return compared((pair[0], pair[1]))[0]


def compared(*pairs: tuple[float, float]) -> tuple[Shown, ...]:
    """Return several 95 % intervals, each of value and standard deviation, with one last digit for all.

    That is the coarsest of them, so the differences of what is shown have no digit that means nothing.
    """
    known = [pair for pair in pairs if math.isfinite(pair[0])]
    if not known:
        return tuple(Shown(UNKNOWN, UNKNOWN) for _ in pairs)
    last = max(_last_digit(*pair) for pair in known)
    leading = max(
        math.floor(math.log10(max(abs(value), width if math.isfinite(width) else 0.0, 10.0**last)))
        for value, width in ((value, Z_95 * deviation) for value, deviation in known)
    )
    power = 0 if leading in _PLAIN else leading
    return tuple(_shown(value, deviation, last, power) for value, deviation in pairs)


def with_interval(value: float | None, standard_deviation: float | None, unit: str = "1") -> str:
    """Return e.g. ``0.498 ± 0.011 N``; the ``±`` is of 95 %, which a heading near it has to say."""
    shown = interval(value, standard_deviation)
    return UNKNOWN if shown.value == UNKNOWN else f"{shown}{unit_text(unit)}"


def width(value: float, standard_deviation: float) -> str:
    """Return the half width of the 95 % interval as it stands behind a value: ``± 0.011 (95 %)``."""
    return f"± {interval(value, standard_deviation).half_width} (95 %)"


def number(value: float, digits: int = _DIGITS) -> str:
    """Return a number without interval: ``digits`` significant digits, the integer part whole."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    leading = _leading(value, digits)
    if leading not in _PLAIN:
        return _written(_rounded(value, leading - digits + 1), leading, leading - digits + 1)
    last = min(0, leading - digits + 1)
    return _written(_rounded(value, last), 0, last)


def percent(share: float, digits: int = 2) -> str:
    """Return a share (1: all) in per cent with its sign, e.g. ``4.0 %``."""
    return f"{number(100.0 * share, digits)} %" if math.isfinite(share) else UNKNOWN


def exact(value: float) -> str:
    """Return a number that is given, not estimated: six significant digits, without noughts at the end."""
    text, mark, power = number(value, 6).partition("e")
    return (text.rstrip("0").rstrip(".") if "." in text else text) + mark + power


def unit_text(unit: str) -> str:
    """Return ``unit`` as it follows a number: with a space, nothing for plain numbers (``1``)."""
    return "" if unit in ("", "1") else f" {unit}"


def rate_power(unit: str) -> int:
    """Return with which power of the sampling rate a parameter of ``unit`` grows, e.g. 2 for `N/m`."""
    if unit in _RATE_POWERS:
        return _RATE_POWERS[unit]
    power = 0
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for factor in part.strip("() ").split():
            base, _, exponent = factor.partition("^")
            power += sign * _RATE_POWERS.get(base, 0) * int(exponent or 1)
    return power


def at_uncertain_rate(quantity: Quantity, rate_std: float) -> Quantity:
    """Return a parameter whose deviation includes that of the sampling rate, ``rate_std`` (relative)."""
    power = rate_power(quantity.unit)
    if rate_std <= 0.0 or power == 0 or not math.isfinite(quantity.standard_deviation):
        return quantity
    deviation = math.hypot(quantity.standard_deviation, rate_std * power * quantity.value)
    return replace(quantity, standard_deviation=deviation)


class Validity(enum.IntEnum):
    """Whether a quantity holds; the numbers are those of ``spool_msgs/msg/Quantity``."""

    UNKNOWN = 0
    VALID = 1
    HELD = 2
    IMPLAUSIBLE = 3


@dataclass(frozen=True, slots=True)
class Quantity:
    """``value`` and ``standard_deviation`` in ``unit``; NaN where not known."""

    name: str
    unit: str
    value: float = math.nan
    standard_deviation: float = math.nan
    validity: Validity = Validity.UNKNOWN

    @property
    def known(self) -> bool:
        """Whether the value may be used: valid, or held from when it was."""
        return self.validity in (Validity.VALID, Validity.HELD)


def named(key: str) -> dict[str, Any]:
    """Return the metadata of a field that JSON calls ``key``."""
    return {"key": key}


def by_name(entries: Iterable[Any]) -> dict[str, Any]:
    """Return ``entries``, each under its ``name`` and without it, as JSON holds them."""
    written = {one.name: as_json(one) for one in entries}
    return {name: {key: part for key, part in one.items() if key != "name"} for name, one in written.items()}


def as_json(value: Any) -> Any:
    """Return ``value`` as JSON holds it: null for numbers that are not finite, lists for arrays and tuples.

    A quantity becomes value, standard deviation and unit, an enum its name in lower case, a path its text. A
    dataclass is written field by field, as the metadata of each says, and then the properties that it lists
    in ``JSON_PROPERTIES``.
    """
    if value is None or isinstance(value, (str, bool)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {key: as_json(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_json(entry) for entry in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Quantity):
        written = {"value": value.value, "std": value.standard_deviation, "unit": value.unit}
        return as_json(written)
    if is_dataclass(value):
        return _fields(value)
    return as_json(value.tolist()) if hasattr(value, "tolist") else value


def _fields(result: Any) -> dict[str, Any]:
    found = {}
    for entry in fields(result):
        own, how = getattr(result, entry.name), entry.metadata
        if how.get("by_name"):
            own = by_name(own)
        if how.get("empty_is_null") and not own:
            own = None
        if not how.get("left_out"):
            found[how.get("key", entry.name)] = as_json(own)
    for name in getattr(result, "JSON_PROPERTIES", ()):
        found[name] = as_json(getattr(result, name))
    return found


def _last_digit(value: float, deviation: float) -> int:
    """Return the decimal exponent of the last digit shown."""
    half = Z_95 * deviation
    size = _leading(value, _DOUBLE) if value else -300
    if math.isfinite(half) and half > 0.0:
        return max(_leading(half, 2) - 1, size - _DOUBLE + 1)
    return size - _DIGITS + 1 if value else 0


def _leading(value: float, digits: int) -> int:
    """Return the decimal exponent of the first of ``digits`` digits, after rounding to them."""
    return int(f"{abs(value):.{digits - 1}e}".partition("e")[2])


def _shown(value: float, deviation: float, last: int, power: int) -> Shown:
    if not math.isfinite(value):
        return Shown(UNKNOWN, UNKNOWN)
    text = _written(_rounded(value, last), power, last)
    half = Z_95 * deviation
    if not (math.isfinite(half) and half >= 0.0):
        return Shown(text, UNKNOWN)
    if half == 0.0:
        return Shown(text, "0")
    # Upwards from a half: value and half width rounded inwards together would lose more than the last digit.
    width = _rounded(half, last, ROUND_HALF_UP)
    if width == 0:
        width = Decimal(half).quantize(Decimal((0, (1,), last)), ROUND_CEILING)
    return Shown(text, _written(width, power, last))


def _rounded(value: float, last: int, rounding: str = ROUND_HALF_EVEN) -> Decimal:
    # From the shortest decimal that is the double: a half is rounded as it is read.
    return Decimal(repr(float(value))).quantize(Decimal((0, (1,), last)), rounding)


def _written(value: Decimal, power: int, last: int) -> str:
    """Return ``value`` down to the digit ``last``, as a multiple of ``10**power``."""
    decimals = max(0, power - last)
    text = f"{value.scaleb(-power) + 0:.{decimals}f}"
    if not text.strip("-0."):
        text = text.lstrip("-")
    return f"{text}e{power}" if power else text
