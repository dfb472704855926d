"""Header of a channel: its name and the unit in it."""

from __future__ import annotations

import re

from .units import level_of, quantity_of

#: Words that name a channel, by the short name of what it is.
WORDS = {
    "time": (
        "time", "t", "zeit", "zeitstempel", "timestamp", "messzeit", "temps", "datetime", "stamp", "uhrzeit",
        "tempo", "czas", "时间", "時間", "время",
    ),
    "body": (
        "body", "housing", "gehäuse", "gehaeuse", "gehause", "ventilgehäuse", "valvebody", "阀体", "корпус",
    ),
    "spool": (
        "spool", "schieber", "steuerschieber", "kolben", "steuerkolben", "valvespool",
        "阀芯", "スプール", "золотник",
    ),
    "oil": ("oil", "öl", "oel", "öltemperatur", "oeltemperatur"),
    "displacement": ("displacement", "weg", "position", "stroke", "verschiebung"),
    "force": ("force", "kraft"),
}  # fmt: skip
_NAMES = frozenset(word for words in WORDS.values() for word in words)
#: What stands in round brackets and describes a place, an axis or a number, not a unit.
_PLACES = re.compile(
    r"left|right|top|bottom|upper|lower|front|rear|back|middle|in|out|inlet|outlet|links|rechts|oben|unten|vorn|"
    r"vorne|hinten|mitte|gauche|droite|[xyz]|[+-][xyz]|[ab]|(?:ch|channel|kanal|axis|achse|nr|no|sensor)?[ "
    r"._]?\d+|"
    r"[xyz][ -]?(?:axis|achse)|pos(?:ition)? ?\d*|formula result|corrected|filtered|raw data|avg|mean",
    re.IGNORECASE,
)
#: Quantity over unit after DIN 1313 and ISO 80000-1: `a / (m/s²)`.
_OVER = re.compile(r"(?P<name>.+?)\s*/\s*(?P<unit>\(.+\)|.+)")
_BESIDE = re.compile(r"(?P<name>.+?)(?:\s+in|,|;|:)\s+(?P<unit>\S.{0,29})")
#: What ends a name in small letters, e.g. `body_m_s2`; a single letter is a unit only where it is one of
#: these.
_ENDING = re.compile(
    r"(?P<name>.+?)[_ ](?P<unit>(?:m|mm|cm)_s(?:_?2)?|m/s\^2|m/s2|m/s²|mps2|mg|g|mv|mV|uV|V|s|ms|us|ns|sec|"
    r"min|degC|degF|C|N|kN|mm|um|m|bar|mbar|k?Pa|MPa|psi|k?Hz|rpm|counts?|cts|lsb|LSB|raw|adc|pct|percent|%|mA|ips)"
    r"(?P<level>[_ ]?(?:rms|RMS|pk|peak|pp|max|min))?"
)
_SCOPE = re.compile(r"(?P<name>CH\d)\s*(?P<unit>m?V)")
#: What says that a channel has no unit.
NO_UNIT = frozenset(
    {"-", "--", "---", "–", "—", "1", "none", "n/a", "na", "unitless", "no unit", "ohne", "?"}
)


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
