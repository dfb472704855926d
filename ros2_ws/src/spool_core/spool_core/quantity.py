"""Quantity: a number with its unit, its uncertainty and whether it holds."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass


class Validity(enum.IntEnum):
    """Validity of a quantity: whether it holds; the numbers are those of ``spool_msgs/msg/Quantity``."""

    UNKNOWN = 0
    VALID = 1
    HELD = 2
    IMPLAUSIBLE = 3


@dataclass(frozen=True, slots=True)
class Quantity:
    """Quantity: ``value`` and ``standard_deviation`` in ``unit``; NaN where not known."""

    name: str
    unit: str
    value: float = math.nan
    standard_deviation: float = math.nan
    validity: Validity = Validity.UNKNOWN

    @property
    def known(self) -> bool:
        """Whether the value may be used: valid, or held from when it was."""
        return self.validity in (Validity.VALID, Validity.HELD)

    def to_dict(self) -> dict[str, float | str]:
        """Return value, standard deviation and unit as results in JSON have them."""
        return {"value": self.value, "std": self.standard_deviation, "unit": self.unit}
