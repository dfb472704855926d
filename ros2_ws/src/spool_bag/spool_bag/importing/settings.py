"""Settings that a file states beside its samples: rates, units, scales, starts and counts, by one rule.

Every format hands its attributes, properties and single numbers to :class:`Settings`, which marks those used;
of a text table :func:`stated_above` finds the rate in the lines above the samples.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.units import VOCABULARY, factor, meanings, quantity_of, split_header

_NAMES: dict[str, list[str]] = VOCABULARY["settings"]
#: Power of the number in a rate: 1 of rates, -1 of periods.
_SURE = {**dict.fromkeys(_NAMES["rates"], 1.0), **dict.fromkeys(_NAMES["periods"], -1.0)}
_DOUBTFUL = {
    **dict.fromkeys(_NAMES["perhaps_rates"], 1.0), **dict.fromkeys(_NAMES["perhaps_periods"], -1.0)
}  # fmt: skip
_POWERS = {**_SURE, **_DOUBTFUL}
#: Units of rates, as settings and lines above samples name them.
RATE_UNITS: dict[str, float] = meanings(VOCABULARY["rate_units"])
#: Attributes that belong to the format itself.
_FORMATS_OWN = re.compile("|".join(VOCABULARY["of_formats"]), re.IGNORECASE)
#: s since 1970 from 2001 to 2038.
_CALENDAR = (1e9, 2.0**31)
#: Relative difference up to which two settings are one rate.
SAME = 1e-6
#: Settings that are named one by one.
MOST_NAMED = 12
#: Settings of a file that are looked at.
MOST = 10_000
_QUANTITY = re.compile(r"\s*([-+]?\d[\d.]*(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?")

#: Units that a rate has whatever it is one of.
_BARE_UNITS = ("", "hz", "khz", "mhz", "hertz", "1/s")
_NUMBER = r"[-+]?(?:\d{1,3}(?:[.,'’\u00a0\u202f ]\d{3})+(?:[.,]\d+)?|\d+(?:[.,]\d+)?)(?:[eE][-+]?\d+)?"
_SETTING = re.compile(
    rf"[#%/\s\"]*(?P<key>[^=:;,\t]*[^\W\d][^=:;,\t]*?)\s*[=:;,\t\s]\s*(?P<value>{_NUMBER})"
    r"\s*(?P<unit>[^\d\s;,]\S*)?[\s;,\"]*"
)
#: A number whose only mark may be one of thousands or of decimals.
_EITHER = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
#: Keys of a rate, of what may be the rate of a flow, of a line or of a shaft as well, and of a period.
_RATE, _MAYBE_RATE, _PERIOD = (
    re.compile("|".join(VOCABULARY["lines_above"][one])) for one in ("rates", "perhaps_rates", "periods")
)


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
        near = list(self._near(channel))
        known = {channel, *(one.path for one in near)}
        elsewhere = [
            Setting(path, _plain_name(path.rpartition("/")[2]), -1.0, value)
            for path, value in self._held.items()
            if path not in known
        ]
        for one in (*near, *elsewhere):
            base, unit = (one.name, "") if one.name in _POWERS else _with_unit(one.name)
            power = _POWERS.get(base, 0.0)
            if not power:
                continue
            size, number = self._size(one, unit, "rate" if power > 0.0 else "time"), _number(one.value)
            if not number > 0.0:
                continue
            if size is None:
                of = self._held.get(self._unit_path(one), one.value)
                doubtful.append(f"{printable(one.path, 60)} = {number:.7g} in {printable(of, 20)}")
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


def stated_above(
    rows: Sequence[Sequence[str]], first: int, above: int, decimal: str
) -> tuple[StatedRate, frozenset[int]]:
    """Return the rate that a setting above the samples states, and the rows of such settings.

    Raises:
        InputError: two of them contradict each other.
    """
    found: list[_Rate] = []
    for at, row in enumerate(rows[:first]):
        below = rows[at + 1] if at + 1 < first else []
        for place, cell in enumerate(row):
            increment = re.fullmatch(r"t_?inc\s*=\s*(\S+)", cell.strip(), re.IGNORECASE)
            number = increment[1] if increment else ""
            if cell.strip().casefold() == "increment" and place < len(below):
                number = below[place]
            if number:
                found += _rates("increment", number.rstrip("sS"), "", at, decimal)
        cells = [cell.strip().strip('"') for cell in row if cell.strip()]
        if at < above or len(cells) <= 2:
            found += _of_line(cells, at, decimal)
    sure = [one for one in found if not one.doubt]
    for one in sure[1:]:
        if abs(one.rate / sure[0].rate - 1.0) > 1e-3:
            raise InputError(
                f"{one.where} says {one.rate:g} Hz and {sure[0].where} says {sure[0].rate:g} Hz: correct one "
                "of them"
            )
    rate, where = (sure[0].rate, printable(sure[0].where, 80)) if sure else (math.nan, "")
    doubt = printable("; ".join(one.doubt for one in found if one.doubt), 200)
    return StatedRate(rate, where, doubt), frozenset(one.row for one in found)


class _Rate(NamedTuple):
    """Rate (Hz) that a row states, where, and why it may be none."""

    rate: float
    where: str
    row: int
    doubt: str = ""


def _of_line(cells: Sequence[str], at: int, decimal: str) -> list[_Rate]:
    """Return the rate that a line of key and value states."""
    # A comma between thousands may separate columns as well.
    if len(cells) > 1 and re.search(r"[=:\s]\d{1,3}$", cells[0]) and re.match(r"\d{3}(?!\d)", cells[1]):
        cells = [f"{cells[0]},{cells[1]}", *cells[2:]]
    if not cells or len(cells) > 4:
        return []
    match = (
        _SETTING.fullmatch(f"{cells[0]}\t{cells[1]}{' ' + cells[2] if len(cells) == 3 else ''}")
        if len(cells) > 1
        else None
    )
    match = match or _SETTING.fullmatch(cells[0])
    if not match:
        return []
    key, unit = split_header(match["key"].strip(" =:"))
    return _rates(key, match["value"], unit or match["unit"] or "", at, decimal)


def _rates(key: str, value: str, unit: str, at: int, decimal: str) -> list[_Rate]:
    """Return the rate of a setting, or what may be one; none for other settings."""
    plain, where = key.strip().lower(), f"'{key}', line {at + 1}"
    ways = []
    for text in _readings(value, decimal):
        try:
            number = float(text)
        except ValueError:
            return []
        rate = _rate(plain, number, unit) if number > 0.0 else math.nan
        if math.isfinite(rate):
            ways.append(rate)
    if not ways:
        return []
    typed = ", or ".join(f"--rate {rate:.7g}" for rate in ways)
    doubt = ""
    if len(ways) > 1:
        doubt = f"{where} is {value}, with a mark of thousands or of decimals: type {typed}"
    elif _MAYBE_RATE.fullmatch(plain) and unit.lower() in _BARE_UNITS:
        doubt = f"{where} may be a sampling rate or not: if it is, type {typed}"
    return [_Rate(ways[0], where, at, doubt)]


def _readings(value: str, decimal: str) -> list[str]:
    """Return a number as Python reads it; two where its mark may be one of thousands or of decimals."""
    plain = re.sub(r"(?<=\d)['’\u00a0\u202f ](?=\d{3})", "", value)
    if _EITHER.fullmatch(plain) and decimal not in plain:
        return [re.sub(r"[.,]", "", plain), re.sub(r"[.,]", ".", plain)]
    if len(re.findall(r"[.,]", plain)) > 1:
        whole, mark, fraction = plain.rpartition("," if plain.rfind(",") > plain.rfind(".") else ".")
        alike = whole.count(mark) > 0
        plain = re.sub(r"[.,]", "", plain) if alike else f"{re.sub(r'[.,]', '', whole)}.{fraction}"
    return [plain.replace(",", ".")]


def _rate(key: str, number: float, unit: str) -> float:
    """Return the rate (Hz) of a setting, NaN where it is none."""
    if (_RATE.fullmatch(key) or _MAYBE_RATE.fullmatch(key)) and unit.lower() in RATE_UNITS:
        return number * RATE_UNITS[unit.lower()]
    if _PERIOD.fullmatch(key) and (not unit or quantity_of(unit) == "time"):
        return 1.0 / (number * (factor(unit, "time") if unit else 1.0))
    return math.nan


def key_and_text(row: Sequence[str], at: int) -> tuple[str, str]:
    """Return the key and the text of a line above the samples."""
    cells = [text for cell in row if (text := cell.strip(' "#%'))]
    match = (
        re.fullmatch(r"(?P<key>[^=:]{1,60}?)\s*[=:]\s*(?P<text>.+)", cells[0]) if len(cells) == 1 else None
    )
    key = match["key"] if match else cells[0].rstrip(" =:") if len(cells) > 1 else ""
    if not key or "/" in key:
        return f"line {at + 1}", ", ".join(cells)
    return key, match["text"] if match else ", ".join(cells[1:])
