"""Use of a channel of a file: what it became, and by which conversion."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.text import printable
from spool_core.uncertainty import EMPTY_IS_NULL

from spool_bag.importing.choices import QUANTITIES, short
from spool_bag.importing.table import STAMP
from spool_bag.importing.units import KEPT, converted

Array = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class ChannelUse:
    """Use of a channel: which column became what, and the conversion of its values.

    Attributes:
        role: contract name, e.g. ``body_m_s2``.
        file, column, number: file, name of the column there, its number from 0.
        unit: the values' unit, "" where none is known.
        factor: what values are multiplied by; NaN for temperatures with an offset.
        option: that decides, "" where the file does.
    """

    role: str
    file: str
    column: str
    number: int
    unit: str
    factor: float
    option: str = field(default="", metadata=EMPTY_IS_NULL)

    def __str__(self) -> str:
        """Column and conversion, for people."""
        kept = KEPT[QUANTITIES[self.role]].replace("**", "^")
        number = f"column #{self.number} " if self.number >= 0 else "column "
        said = f"{short(self.role)}: {number}'{printable(self.column, 60)}'"
        if self.unit == STAMP:
            said += ", dates or times of day"
        elif self.factor == 1.0:
            said += f" in {kept}"
        elif np.isnan(self.factor):
            said += f", {printable(self.unit, 30)} converted to {kept}"
        else:
            said += f", 1 {printable(self.unit, 30)} = {self.factor:.7g} {kept}"
        return said + (f" ({self.option})" if self.option else "")

    def applied(self, values: Array) -> Array:
        """Return values, shape (n,), in the unit of the role; a row of float32 stays one."""
        if self.factor == 1.0:
            return values
        if np.isnan(self.factor):
            return converted(values.astype(np.float64), self.unit, QUANTITIES[self.role]).astype(values.dtype)
        return (values.astype(np.float64) * self.factor).astype(values.dtype)
