"""Settings above the samples of a text table: lines of key and value, and the rates that they state."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.settings import RATE_UNITS, StatedRate
from spool_bag.importing.units import factor, quantity_of, split_header

#: Units that a rate has whatever it is one of.
_BARE_UNITS = ("", "hz", "khz", "mhz", "hertz", "1/s")
_NUMBER = r"[-+]?(?:\d{1,3}(?:[.,'’\u00a0\u202f ]\d{3})+(?:[.,]\d+)?|\d+(?:[.,]\d+)?)(?:[eE][-+]?\d+)?"
_SETTING = re.compile(
    rf"[#%/\s\"]*(?P<key>[^=:;,\t]*[^\W\d][^=:;,\t]*?)\s*[=:;,\t\s]\s*(?P<value>{_NUMBER})"
    r"\s*(?P<unit>[^\d\s;,]\S*)?[\s;,\"]*"
)
#: A number whose only mark may be one of thousands or of decimals.
_EITHER = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")
_RATE = re.compile(
    r"(?:actual |effective |nominal )?(?:sampl(?:e|es|ing)|scan|abtast|mess|acquisition|logging|采样)"
    r"[ _-]*(?:rate|freq(?:uency)?|frequenz|频率|率)|f_?s|odr|output data rate|samples?/s|samples per second"
)
#: What may be the rate of samples, or of a flow, of a line or of a shaft.
_MAYBE_RATE = re.compile(r"(?:data[ _-]*)?rate|freq(?:uency)?|frequenz")
_PERIOD = re.compile(
    r"(?:sampl(?:e|es|ing)|scan|abtast|mess)[ _-]*(?:time[ _-]*)?"
    r"(?:interval|intervall|period|periode|step|schritt|increment|zeit)|"
    r"x?[ _]?incr?(?:ement)?|delta[ _]?[xt]|d[xt]|t_?inc|t_?interval|isi|time[ _]?(?:step|increment)|"
    r"h(?:orizontal)?[ _]interval"
)


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
    if len(ways) > 1:
        return [
            _Rate(
                ways[0],
                where,
                at,
                f"{where} is {value}, with a mark of thousands or of decimals: type {typed}",
            )
        ]
    if _MAYBE_RATE.fullmatch(plain) and unit.lower() in _BARE_UNITS:
        return [_Rate(ways[0], where, at, f"{where} may be a sampling rate or not: if it is, type {typed}")]
    return [_Rate(ways[0], where, at)]


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
