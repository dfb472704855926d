"""Settings that a file states beside its samples: rates, units, scales, starts and counts, by one rule.

Every format hands its attributes, properties and single numbers to :class:`Settings`, which marks those used.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np
from spool_core.text import printable

from spool_bag.importing.units import VOCABULARY, factor, meanings, quantity_of, split_header

_NAMES: dict[str, list[str]] = VOCABULARY["settings"]
#: Power of the number in a rate: 1 of rates, -1 of periods.
_SURE = {**dict.fromkeys(_NAMES["rates"], 1.0), **dict.fromkeys(_NAMES["periods"], -1.0)}
_DOUBTFUL = {
    **dict.fromkeys(_NAMES["perhaps_rates"], 1.0), **dict.fromkeys(_NAMES["perhaps_periods"], -1.0)
}  # fmt: skip
#: Units of rates, as settings and lines above samples name them.
RATE_UNITS: dict[str, float] = meanings(VOCABULARY["rate_units"])
#: Attributes that belong to the format itself.
_FORMATS_OWN = re.compile(
    r"class|title|version|name|dimension_list|reference_list|dimension_labels|_netcdf.*|_nc.*|field_\d.*|"
    r"flavor|matlab_.*|h5path|pytables.*|axis\d.*|block\d.*|nblocks|encoding|errors|pandas.*|ndim|nrows|"
    r"arrow:schema|__.*",
    re.IGNORECASE,
)
#: s since 1970 from 2001 to 2038.
_CALENDAR = (1e9, 2.0**31)
#: Relative difference up to which two settings are one rate.
SAME = 1e-6
#: Settings that are named one by one.
MOST_NAMED = 12
#: Settings of a file that are looked at.
MOST = 10_000
_QUANTITY = re.compile(r"\s*([-+]?\d[\d.]*(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")


@dataclass(frozen=True, slots=True)
class StatedRate:
    """Rate (Hz) that a setting states for a channel, NaN for none; ``source``: the settings' own names.

    ``doubt``: why none is taken though there are settings, with what to type.
    """

    rate: float = math.nan
    source: str = ""
    doubt: str = ""


class Scaling(NamedTuple):
    """Conversion of stored numbers to those of the unit: factor and offset, and numbers that stand for none.

    ``doubt``: a setting that may still have to be applied, ``size`` its number.
    """

    factor: float = 1.0
    offset: float = 0.0
    missing: tuple[float, ...] = ()
    doubt: str = ""
    size: float = math.nan

    @property
    def applied(self) -> bool:
        """Whether numbers are changed."""
        return (self.factor, self.offset, self.missing) != (1.0, 0.0, ())

    def __str__(self) -> str:
        """Conversion, for people."""
        said = f"stored numbers times {self.factor:.7g} plus {self.offset:.7g}, as the file states"
        return said + (
            f"; {' and '.join(f'{one:g}' for one in self.missing)} is no value" if self.missing else ""
        )


#: Conversion of numbers that are those of their unit.
NEUTRAL = Scaling()


class Start(NamedTuple):
    """Time of the first sample: ns since 1970 of a moment, ``None`` where not stated, and s from there on."""

    moment: int | None = None
    delay: float = 0.0


class Setting(NamedTuple):
    """Setting beside a channel: its path, its name without that of the channel, how near it is, its value."""

    path: str
    name: str
    depth: float
    value: Any


class Settings:
    """All settings of a file by their paths, e.g. ``bearing/sr``, and which of them were used."""

    def __init__(self, held: Mapping[str, Any] | None = None) -> None:
        few = dict(list((held or {}).items())[:MOST])
        self._held = {path: value for path, raw in few.items() if (value := _plain(raw)) is not None}
        self._used: set[str] = set()
        self._paths = {_placed(path): path for path in self._held}

    def unit(self, channel: str) -> str:
        """Return the unit that is stated for a channel, its own or that of all beside it; "" for none."""
        parent, _, leaf = channel.rpartition("/")
        for word in _NAMES["units"][:2]:  # units of all channels by their names, in a separate group
            path = self._paths.get(_placed(f"{parent}/{word}/{leaf}".lstrip("/")), "")
            if path and isinstance(self._held[path], str):
                self._used.add(path)
                return str(self._held[path]).strip()
        near = [
            one for one in self._near(channel) if one.name in _NAMES["units"] and isinstance(one.value, str)
        ]
        own = [one for one in near if one.depth >= max(channel.count("/"), 0.5)]
        return str(self._take(max(own, key=lambda one: one.depth)).value).strip() if own else ""

    def rate(self, channel: str) -> StatedRate:
        """Return the rate that holds for a channel: of the nearest settings, else of those elsewhere."""
        sure: list[tuple[Setting, float]] = []
        doubtful: list[str] = []
        for one in (*self._near(channel), *self._elsewhere(channel)):
            power, size, number = self._rate_of(one)
            if not power or not number > 0.0:
                continue
            if size is None:
                unit = self._held.get(self._unit_path(one), one.value)
                doubtful.append(f"{printable(one.path, 60)} = {number:.7g} in {printable(unit, 20)}")
            elif one.name in _SURE or _with_unit(one.name)[0] in _SURE:
                sure.append((one, (number * size) ** power))
            elif one.depth >= 0:
                doubtful.append(f"{printable(one.path, 60)} = {number:.7g}")
        if not sure:
            may_be = f"{' and '.join(doubtful)} may be a sampling rate or not: if it is, type it with --rate"
            return StatedRate(doubt=may_be if doubtful else "")
        nearest = max(one.depth for one, _ in sure)
        taken = [(self._take(one), rate) for one, rate in sure if one.depth == nearest]
        rate = taken[0][1]
        if any(abs(other / rate - 1.0) > SAME for _, other in taken):
            said = " and ".join(f"{printable(one.path, 60)} = {other:.7g} Hz" for one, other in taken[:4])
            return StatedRate(doubt=f"{said} disagree: type the right one, e.g. --rate {rate:.7g}")
        return StatedRate(rate, printable(" and ".join(one.path for one, _ in taken[:3]), 120))

    def scaling(self, channel: str, *, whole: bool) -> Scaling:
        """Return how the stored numbers of a channel become those of its unit.

        ``scale_factor`` and ``add_offset`` (CF conventions, section 8.1) are applied. Others, also those that
        stand once for the file, are in doubt where the stored numbers are ``whole``, else left to be named.
        """
        near = list(self._near(channel))
        own = [one for one in near if one.depth >= channel.count("/") + 0.5]
        numbers = {one.name: (one, number) for one in own if math.isfinite(number := _number(one.value))}
        size, offset, missing = 1.0, 0.0, []
        for name in ("scale_factor", "add_offset"):  # as the conventions spell them
            if name in numbers and numbers[name][0].path.endswith(name):
                one, number = numbers.pop(name)
                self._take(one)
                size, offset = (number, offset) if name == "scale_factor" else (size, number)
        for name in _NAMES["missing"]:
            if name in numbers:
                self._take(numbers[name][0])
                missing.append(numbers[name][1])
        for name, (one, number) in numbers.items():
            neutral = number == (1.0 if name in _NAMES["scales"] else 0.0)
            if name not in (*_NAMES["scales"], *_NAMES["shifts"]) or size != 1.0 or offset != 0.0:
                continue
            if neutral:
                self._take(one)
            elif whole and name in _NAMES["scales"]:
                doubt = f"{printable(one.path, 60)} = {number:.7g}"
                return Scaling(size, offset, tuple(missing), doubt, number)
        for one in near if whole and (size, offset) == (1.0, 0.0) else ():
            number = _number(one.value)
            if (
                one.name in (*_NAMES["scales"], *_NAMES["sensitivities"])
                and number not in (0.0, 1.0)
                and math.isfinite(number)
            ):
                doubt = f"the file states {printable(one.path, 60)} = {number:.7g}"
                return Scaling(size, offset, tuple(missing), doubt, number)
        return Scaling(size, offset, tuple(missing))

    def start(self, channel: str) -> Start:
        """Return when the first sample of a channel was taken."""
        moment, delay = None, 0.0
        near = [
            (one, unit)
            for one in sorted(self._near(channel), key=lambda one: -one.depth)
            for base, unit in [_with_unit(one.name)]
            if base in (*_NAMES["starts"], *_NAMES["delays"])
        ]
        taken: list[Setting] = []
        for one, unit in near:
            found = moment_of(one.value) if _with_unit(one.name)[0] in _NAMES["starts"] else None
            if found is not None:
                if moment is None:
                    moment = found
                    taken.append(one)
                continue
            size = self._size(one, unit, "time")
            number = _number(one.value)
            # A number for all channels alike moves nothing against each other.
            if delay == 0.0 and size is not None and math.isfinite(number) and one.depth > 0.0:
                delay = number * size
                taken.append(one)
        for one in taken:
            self._take(one)
        return Start(moment, delay)

    def filters(self, channel: str) -> dict[str, str]:
        """Return by name what is stated of the filter and the decimation of one channel alone."""
        own = [one for one in self._near(channel) if one.depth >= channel.count("/") + 0.5]
        return {
            base: printable(_shown(one.value), 40)
            for one in own
            for base in [one.name if one.name in _NAMES["filters"] else _with_unit(one.name)[0]]
            if base in _NAMES["filters"]
        }

    def count(self, channel: str) -> float:
        """Return how many samples of a channel are stated, NaN for none."""
        return self._amount(channel, _NAMES["counts"], "")

    def span(self, channel: str) -> float:
        """Return the duration (s) that is stated for a channel, NaN for none."""
        return self._amount(channel, _NAMES["durations"], "time")

    def use(self, *paths: str) -> None:
        """Mark settings as used, as formats do with those of which they take care themselves."""
        self._used.update(paths)

    def unused(self, channels: Iterable[str]) -> list[str]:
        """Return the settings beside ``channels`` that nothing used, as ``path = value``."""
        found: dict[str, None] = {}
        for channel in channels:
            for one in self._near(channel):
                name = one.path.rpartition("/")[2]
                if one.path not in self._used and not _FORMATS_OWN.fullmatch(name):
                    found[f"{printable(one.path, 60)} = {printable(_shown(one.value), 40)}"] = None
        return list(found)

    def _near(self, channel: str) -> Iterator[Setting]:
        """Yield the settings of a channel and of what it lies in, the nearest the deepest."""
        parent, _, leaf = split_header(channel)[0].rpartition("/")
        for path, value in self._held.items():
            if path == channel:
                continue
            at, _, name = path.rpartition("/")
            plain = _plain_name(name)
            own = f"{_plain_name(leaf)}_"
            if at == channel:
                yield Setting(path, plain, channel.count("/") + 1.0, value)
            elif at == parent and plain.startswith(own) and len(plain) > len(own):
                yield Setting(path, plain.removeprefix(own), channel.count("/") + 0.5, value)
            elif not at or channel.startswith(f"{at}/"):
                yield Setting(path, plain, float(0 if not at else 1 + at.count("/")), value)

    def _elsewhere(self, channel: str) -> Iterator[Setting]:
        near = {one.path for one in self._near(channel)}
        for path, value in self._held.items():
            if path not in near and path != channel:
                yield Setting(path, _plain_name(path.rpartition("/")[2]), -1.0, value)

    def _rate_of(self, one: Setting) -> tuple[float, float | None, float]:
        """Return power (0: no rate), size of the unit (``None``: not known) and number of a setting."""
        known = {**_SURE, **_DOUBTFUL}
        base, unit = (one.name, "") if one.name in known else _with_unit(one.name)
        power = known.get(base, 0.0)
        if not power:
            return 0.0, None, math.nan
        return power, self._size(one, unit, "rate" if power > 0.0 else "time"), _number(one.value)

    def _size(self, one: Setting, unit: str, quantity: str) -> float | None:
        """Return the size of a setting's unit: in its name, its text, or beside it; ``None``: not known."""
        match = _QUANTITY.fullmatch(one.value) if isinstance(one.value, str) else None
        beside = self._unit_path(one)
        text = unit or (match[2] if match and match[2] else "") or str(self._held.get(beside, ""))
        if beside in self._held:
            self._used.add(beside)
        text = text.strip().strip("[]()")
        if quantity == "rate":
            return RATE_UNITS.get(text.lower().replace(" ", ""))
        if not text:
            return 1.0
        return factor(text, "time") if quantity_of(text) == "time" else None

    def _unit_path(self, one: Setting) -> str:
        """Return the path of the setting that states the unit of ``one``, "" where there is none."""
        parent, _, name = one.path.rpartition("/")
        ways = [f"{one.path}{mark}{word}" for mark in "_/" for word in _NAMES["units"][:2]]
        ways += [f"{parent}/{word}/{name}".lstrip("/") for word in _NAMES["units"][:2]]
        return next((self._paths[_placed(way)] for way in ways if _placed(way) in self._paths), "")

    def _amount(self, channel: str, names: Sequence[str], quantity: str) -> float:
        for one in sorted(self._near(channel), key=lambda one: -one.depth):
            base, unit = (one.name, "") if one.name in names else _with_unit(one.name)
            size = self._size(one, unit, quantity) if quantity else 1.0
            number = _number(one.value)
            if base in names and size is not None and number > 0.0:
                self._take(one)
                return number * size
        return math.nan

    def _take(self, one: Setting) -> Setting:
        self._used.add(one.path)
        return one


def _plain_name(name: str) -> str:
    """Return a setting's name in small letters with underscores, e.g. of `SampleRate (kHz)`."""
    bare, unit = split_header(name)
    if quantity_of(unit) in ("time", "frequency") and bare != name:
        name = f"{bare}_{unit}"
    apart = re.sub(r"(?<=[a-z])(?<!k)(?=[A-Z])|(?<=[a-z])(?=kHz)", "_", name.strip())
    return re.sub(r"[\s.-]+", "_", apart.lower())


def _placed(path: str) -> str:
    """Return a path whose last name is plain."""
    parent, mark, name = path.rpartition("/")
    return f"{parent}{mark}{_plain_name(name)}"


def _with_unit(name: str) -> tuple[str, str]:
    """Return a setting's name and the unit that ends it, e.g. of ``fs_khz``; the unit is "" without one."""
    base, _, suffix = name.rpartition("_")
    known = suffix in ("hz", "khz", "mhz", "s", "sec", "seconds", "ms", "us", "ns")
    return (base, {"seconds": "s"}.get(suffix, suffix)) if base and known else (name, "")


def _plain(raw: Any) -> Any:
    """Return a setting as a number or text, the first values of an array; ``None`` for what is neither."""
    if isinstance(raw, (str, bytes)):
        return raw.decode("utf-8", "replace") if isinstance(raw, bytes) else raw
    try:
        held = np.asarray(raw)
        if held.dtype.kind == "M" and held.size == 1:
            return str(held.astype("datetime64[ns]").reshape(-1)[0])
        if held.dtype.kind in "SUO" and held.size == 1:
            one = held.reshape(-1)[0]
            return one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one)
        if held.dtype.kind in "fiub" and held.size == 1:
            return float(held.reshape(-1)[0])
        return tuple(held.reshape(-1)[:4].tolist()) if held.size > 1 else None
    except (TypeError, ValueError):
        return None


def _number(value: Any) -> float:
    """Return a setting's number, NaN for others; commas between digits are no number's."""
    if isinstance(value, float):
        return value
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    try:
        return float(match[1]) if match else math.nan
    except ValueError:
        return math.nan


def moment_of(value: Any) -> int | None:
    """Return a date by ISO 8601, or a number of s, ms, us or ns since 1970, in ns."""
    if isinstance(value, str):
        try:
            whole, mark, rest = value.strip().replace("Z", "+00:00").partition(".")
            digits = re.match(r"\d*", rest)
            fraction = digits[0] if mark and digits else ""
            moment = datetime.fromisoformat(whole + rest[len(fraction) :])
        except ValueError:
            return None
        moment = moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)
        return round(moment.timestamp()) * 1_000_000_000 + int(f"{fraction[:9]:0<9}")
    for size in (1.0, 1e-3, 1e-6, 1e-9) if isinstance(value, float) else ():
        if _CALENDAR[0] < value * size < _CALENDAR[1]:
            return round(float(value) * size * 1e6) * 1000
    return None


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}{', ...' if len(value) > 3 else ''}]"
    return value if isinstance(value, str) else f"{value:.7g}"
