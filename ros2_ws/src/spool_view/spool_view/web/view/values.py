"""Values as browsers get them: shown digits with half widths, nothing where nothing is known."""

from __future__ import annotations

import math
from typing import Any

from spool_core.uncertainty import Z_95, interval, number
from spool_msgs.msg import Quantity

_VALIDITIES = {
    Quantity.VALIDITY_VALID: "valid",
    Quantity.VALIDITY_HELD: "held",
    Quantity.VALIDITY_IMPLAUSIBLE: "implausible",
}


def known(quantity: Any) -> bool:
    """Return whether the message ``quantity`` has a number that holds."""
    usable = quantity.validity in (Quantity.VALIDITY_VALID, Quantity.VALIDITY_HELD)
    return usable and math.isfinite(quantity.value)


def shown(quantity: Any) -> dict[str, Any]:
    """Return ``quantity`` as text with its 95 % half width, and as numbers for pictures."""
    base = {
        "name": quantity.name,
        "unit": quantity.unit,
        "validity": _VALIDITIES.get(quantity.validity, "unknown"),
    }
    if base["validity"] == "unknown" or not math.isfinite(quantity.value):
        return {**base, "text": None, "half": None, "value": None, "width": None}
    if math.isfinite(quantity.standard_deviation):
        text = interval(quantity.value, quantity.standard_deviation)
        return {
            **base,
            "text": text.value,
            "half": text.half_width,
            "value": rounded(quantity.value),
            "width": rounded(Z_95 * quantity.standard_deviation),
        }
    return {
        **base,
        "text": number(quantity.value),
        "half": None,
        "value": rounded(quantity.value),
        "width": None,
    }


def rounded(value: float, digits: int = 6) -> float | None:
    """Return ``value`` with so many significant digits, ``None`` where it is no number."""
    return float(f"{value:.{digits - 1}e}") if math.isfinite(value) else None


def hertz(quantity: Any) -> str | None:
    """Return a frequency with one decimal, ``None`` where there is none."""
    return f"{quantity.value:.1f}" if known(quantity) else None
