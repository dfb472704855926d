"""Header of a channel: its name and the unit in it."""

from __future__ import annotations

import re

from .units import quantity_of

#: `body [g]`, `body (m/s²)`; `a / (m/s²)` and `a in g` as DIN 1313 and ISO 80000-1 have it; `body, g`;
#: `body_g`.
_PATTERNS = (
    re.compile(r"(?P<name>.+?)\s+/\s*\(?(?P<unit>[^()]{1,30})\)?\s*"),
    re.compile(r"(?P<name>.*?)\s*[\[({](?P<unit>[^\[\]{}]{1,30})[\])}]\s*"),
    re.compile(r"(?P<name>.+?)(?:\s+in|,|;|:)\s+(?P<unit>\S{1,30})\s*"),
    re.compile(
        r"(?P<name>.+?)[_ ](?P<unit>m_s2|mm_s2|m/s\^2|m/s2|m/s²|mps2|mg|g|mV|uV|V|"
        r"s|ms|us|ns|sec|min|degC|C|N|kN|mm|um|m)"
    ),
)


def split_header(text: str) -> tuple[str, str]:
    """Return name and unit of a channel's header; the unit is "" where none is named.

    What stands in brackets and is no unit belongs to the name.
    """
    text = text.strip()
    for pattern in _PATTERNS:
        match = pattern.fullmatch(text)
        if match and quantity_of(match["unit"]):
            return match["name"].strip(), match["unit"].strip()
    return text, ""
