"""Units as loggers write them, and where in a header they stand."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.files import load_yaml
from spool_core.numbers import Array
from spool_core.text import printable

#: Words by which loggers name units, channels and settings.
VOCABULARY: Any = load_yaml(Path(__file__).with_name("vocabulary.yaml").read_text("utf-8"))


def meanings(listed: Mapping[Any, Iterable[str]]) -> dict[str, Any]:
    """Return what each word means, of a part of the vocabulary that lists the words by their meaning."""
    return {word: meaning for meaning, words in listed.items() for word in words}


#: Unit in which each quantity is kept, and the units to choose from where a file names none.
KEPT = {"acceleration": "m/s**2", "time": "s", "temperature": "degC", "length": "m", "force": "N",
        "frequency": "rpm"}  # fmt: skip
#: What a sensor puts out before its sensitivity is applied, and the unit of each.
READINGS = {"voltage": "V", "reading": "FS", "count": "count", "current": "A", "charge": "coulomb"}
#: Largest unit of a quantity (in that of ``KEPT`` or ``READINGS``) that a logger uses: a megavolt or a mega-g
#: is a misread prefix.
_LARGEST = {"acceleration": 100.0, "voltage": 1e3, "current": 1.0, "charge": 1e-6, "time": 86400.0}

_AS_WRITTEN: dict[str, str] = meanings(VOCABULARY["written"])
_WORDS: dict[str, str] = meanings(VOCABULARY["within"])
_MARKS = str.maketrans(meanings(VOCABULARY["marks"]))
#: A power of ten ahead of a unit, as in `10^-3 g`.
_POWER = re.compile(
    r"(?:1?[xX*]?10\s*(?:\^|\*\*)?\s*|1[eE])(?P<power>[+-]?\d)\s*[*·]?\s*(?P<unit>[A-Za-z].*)"
)
_PREFIXES = {"-3": "m", "-6": "u", "-9": "n", "-12": "p", "3": "k", "+3": "k", "6": "M"}
_WRITABLE = re.compile(r"[\w\s./*()+-]{1,60}")
_TOKEN = re.compile(r"[A-Za-z_°]+")
_LEVEL = re.compile(
    r"(?P<unit>.+?)[\s_,;(\[-]*(?P<word>(?:true |0[ -]?|1/2 ?)?"
    r"(?:pk[ -]?(?:to[ -]?)?pk|p[ -]?p|peak[ -]?to[ "
    r"-]?peak|pk|peak|rms|eff|avg|mean|max|min|crest|spitze))[\s)\]]*",
    re.IGNORECASE,
)

#: Words that name a channel, by the short name of what it is.
WORDS: dict[str, list[str]] = VOCABULARY["channels"]
_NAMES = frozenset(word for words in WORDS.values() for word in words)
#: What stands in round brackets and describes a place, an axis or a number, not a unit.
_PLACES = re.compile("|".join(VOCABULARY["places"]), re.IGNORECASE)
#: Quantity over unit after DIN 1313 and ISO 80000-1: `a / (m/s²)`.
_OVER = re.compile(r"(?P<name>.+?)\s*/\s*(?P<unit>\(.+\)|.+)")
_BESIDE = re.compile(r"(?P<name>.+?)(?:\s+in|,|;|:)\s+(?P<unit>\S.{0,29})")
#: What ends a name in small letters, e.g. `body_m_s2`; a single letter is a unit only where it is one of
#: these.
_ENDING = re.compile(
    rf"(?P<name>.+?)(?<![_ ]per)[_ ](?P<unit>{'|'.join(VOCABULARY['endings'])})"
    r"(?P<level>[_ ]?(?:rms|RMS|pk|peak|pp|max|min))?"
)
_SCOPE = re.compile(r"(?P<name>CH\d)\s*(?P<unit>m?V)")
#: What says that a channel has no unit.
NO_UNIT = frozenset(VOCABULARY["no_unit"])


@cache
def normalised(text: str) -> str:
    """Return a unit as pint reads it: of `m/s²`, `[m s^-2]`, `(mV)`, `Volt`, `M/S2`."""
    text = re.sub(r"\s+since\s.*", "", text)  # a time since a date (CF conventions, section 4.4)
    plain = (
        unicodedata.normalize("NFKC", text.replace("Â", "")).translate(_MARKS).strip()
    )  # of UTF-8 read as Latin-1
    plain = plain.strip("\"'").rstrip("*").strip()  # Shimmer marks calibrated channels by a star
    power = _POWER.fullmatch(plain)
    if power and power["power"] in _PREFIXES:
        plain = _PREFIXES[power["power"]] + power["unit"]
    while plain[:1] + plain[-1:] in ("[]", "()", "{}", "<>") and _brackets(plain) == [(0, len(plain))]:
        plain = plain[1:-1].strip()
    known = _AS_WRITTEN.get(plain.casefold()) if plain != "MV" else ""
    if known or plain == "Nm":
        return known or "N*m"
    if re.fullmatch(r"ms\s*(?:\^|\*\*)?\s*\(?-2\)?", plain):  # metre, not millisecond: IUPAP writes it so
        return "m/s**2"
    plain = re.sub(r"(?<=[A-Za-z)])\.(?=[A-Za-z(])", "*", plain)
    plain = _TOKEN.sub(lambda match: _WORDS.get(match[0].casefold(), match[0]), plain)
    plain = re.sub(
        r"([A-Za-z)])\s*(?:\^|\*\*)?\s*(?:\(\s*([+-]?[1-4])\s*\)|([+-]?[1-4]))(?![\d.])", r"\1**\2\3", plain
    )
    if re.fullmatch(r"[MCUFTIN]{1,2}/S(?:EC)?(?:(?:\*\*2)|/S(?:EC)?)?", plain) or plain in (
        "S",
        "MS",
        "US",
        "MG",
    ):
        plain = plain.lower()
    return re.sub(r"(?<=[\w)])\s+(?=[A-Za-z(])", "*", re.sub(r"\s*([*/])\s*", r"\1", plain))


def quantity_of(unit: str) -> str:
    """Return what ``unit`` measures, e.g. ``acceleration``, ``voltage``, ``pressure``; "" where not known.

    What is kept is a key of ``KEPT``, what a sensitivity converts a key of ``READINGS``.
    """
    return _quantity(normalised(unit))


def level_of(unit: str) -> tuple[str, str] | None:
    """Return base unit and statistic of a level such as `g RMS`, `gpk` or `m/s² peak`; ``None`` for others.

    Such a header names a statistic, or a scaling of the instrument; whether the samples are one is for
    the user to say.
    """
    if quantity_of(unit):
        return None
    match = _LEVEL.fullmatch(unicodedata.normalize("NFKC", unit).strip().strip("[](){}"))
    if match and quantity_of(match["unit"]):
        return match["unit"].strip(), match["word"].strip()
    return None


def converted(values: Array, unit: str, quantity: str) -> Array:
    """Return ``values``, shape (n,), of ``unit`` in the unit in which ``quantity`` is kept.

    Raises:
        InputError: ``unit`` does not measure ``quantity``.
    """
    if quantity_of(unit) != quantity:
        article = "an" if quantity[0] in "aeiou" else "a"
        raise InputError(f"{printable(unit, 30)!r} is no unit of {article} {quantity}")
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
    """Sensitivity of a sensor, e.g. ``100mV/g``: reading over acceleration, or ``1.25e-6g/count``.

    Attributes:
        text: as given. reading: unit of the reading, e.g. ``mV``.

    Raises:
        InputError: neither of both.
    """

    def __init__(self, text: str) -> None:
        self.text = text.strip()
        match = re.fullmatch(r"([-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)", self.text)
        size = float(match[1]) if match else 0.0
        whole = re.sub(r"\s+per\s+", "/", match[2]).strip() if match else ""
        if size and quantity_of(whole) == "acceleration":  # 50 m/s^2: of a reading of 1, full scale
            self.reading, self._per_unit = "FS", size * factor(whole, "acceleration")
            return
        for at in (at for at, mark in enumerate(whole) if size and mark == "/"):
            upper, lower = whole[:at].strip(), whole[at + 1 :].strip()
            if quantity_of(upper) == "acceleration" and quantity_of(lower) in READINGS:
                self.reading, self._per_unit = normalised(lower), size * factor(upper, "acceleration")
                return
            if quantity_of(upper) in READINGS and quantity_of(lower) == "acceleration":
                self.reading, self._per_unit = normalised(upper), factor(lower, "acceleration") / size
                return
        raise InputError(
            f"{printable(text, 40)!r}: write the sensor's sensitivity like 100mV/g, 10.2mV/(m/s^2), "
            "1.25e-6g/count for raw counts, or 50g/FS for readings from -1 to 1"
        )

    def scale(self, unit: str) -> float:
        """Return the acceleration (m/s^2) of a reading of 1 ``unit`` (empty: that of the sensitivity).

        Raises:
            InputError: ``unit`` is not what the sensor gives.
        """
        here = normalised(unit) or self.reading
        if quantity_of(here) != quantity_of(self.reading):
            raise InputError(
                f"it is in {printable(unit, 30)}, a sensitivity of {printable(self.text, 40)} "
                f"is for readings in {self.reading}"
            )
        return float(_registry().Quantity(1.0, here).to(self.reading).magnitude) * self._per_unit

    def acceleration(self, values: Array, unit: str) -> Array:
        """Return readings of ``unit`` (empty: that of the sensitivity) as accelerations in m/s^2.

        Raises:
            InputError: ``unit`` is not what the sensor gives.
        """
        return values * self.scale(unit)


def is_unit(text: str) -> bool:
    """Return whether ``text`` is a unit that is known, if only to name what it measures."""
    return bool(quantity_of(text)) or level_of(text) is not None


def split_header(text: str) -> tuple[str, str]:
    """Return name and unit of a channel's header; the unit is "" where none is named.

    What stands in brackets at the end is a unit even where it is not known, except for a channel's name, a
    place or an axis: what the header names must not be taken for nothing.
    """
    text = text.strip()
    groups = _brackets(text)
    for begin, end in reversed(groups):
        inner = text[begin + 1 : end - 1].strip()
        if inner and is_unit(inner):
            over = re.fullmatch(r"(.+?)\s*/\s*", text[:begin])
            return _name(over[1] if over else text[:begin], text[end:]), inner
    for begin, end in reversed(groups):
        inner = text[begin + 1 : end - 1].strip()
        describes = inner.casefold() in _NAMES or (text[begin] in "(<" and _PLACES.fullmatch(inner))
        if inner and not describes and end == len(text) and begin > 0:
            return _name(text[:begin], ""), inner
    for pattern in (_OVER, _BESIDE, _SCOPE):
        match = pattern.fullmatch(text)
        if match and is_unit(match["unit"]):
            return match["name"].strip(), match["unit"].strip()
    match = _ENDING.fullmatch(text)
    if match:
        return match["name"].strip(), (match["unit"] + (match["level"] or "").replace("_", " ")).strip()
    return text, ""


@cache
def _registry() -> Any:
    import pint  # noqa: PLC0415 - 0.2 s that nobody else needs

    return pint.UnitRegistry(VOCABULARY["definitions"].splitlines(), cache_folder=None)


@cache
def _quantity(plain: str) -> str:
    if not plain or not _WRITABLE.fullmatch(plain) or re.search(r"\*\*\s*-?\d{2}|\d{4}", plain):
        return ""
    try:
        found = _registry().Unit(plain)
    except Exception:
        return ""
    known: dict[str, str] = {**KEPT, **READINGS, **VOCABULARY["quantities"]}
    for quantity, kept in known.items():
        if found.dimensionality == _registry().Unit(kept).dimensionality:
            if quantity in ("temperature",):
                return quantity
            size = float(_registry().Quantity(1.0, plain).to(kept).magnitude)
            return quantity if size <= _LARGEST.get(quantity, 1e12) else ""
    return ""


def _name(before: str, after: str) -> str:
    return re.sub(r"\s+", " ", f"{before.strip()} {after.strip()}").strip()


def _brackets(text: str) -> list[tuple[int, int]]:
    """Return begin and end of each outermost pair of brackets."""
    found, depth, begin = [], 0, 0
    for at, letter in enumerate(text):
        if letter in "[({<":
            begin = begin if depth else at
            depth += 1
        elif letter in "])}>" and depth:
            depth -= 1
            if depth == 0:
                found.append((begin, at + 1))
    return found
