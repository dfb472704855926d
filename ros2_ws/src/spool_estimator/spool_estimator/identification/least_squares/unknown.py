"""Unknowns of a least-squares fit: what it finds, within which bounds, and in what size of steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Size of an unknown near 0, as a share of its typical size.
SMALLEST_SIZE = 0.1


@dataclass(frozen=True, slots=True)
class Unknown:
    """Unknown of a fit: name, unit (SI), bounds and typical size; ``absolute``: steps do not grow with it."""

    name: str
    unit: str
    low: float
    high: float
    scale: float
    absolute: bool = False

    def size(self, value: float) -> float:
        """Return the size of ``value`` that steps are taken in proportion to."""
        return self.scale if self.absolute else max(abs(value), SMALLEST_SIZE * self.scale)


def bounds_of(unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
    """Return the lower and the upper bounds of ``unknowns``, shape (u,) each."""
    low = np.array([unknown.low for unknown in unknowns])
    high = np.array([unknown.high for unknown in unknowns])
    return low, high


def sizes_of(unknowns: Sequence[Unknown], point: Array) -> Array:
    """Return the size of each number of ``point`` (u,), same shape."""
    return np.array([unknown.size(value) for unknown, value in zip(unknowns, point.tolist(), strict=True)])
