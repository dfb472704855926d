"""Confidence ellipse of two numbers of a fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: 95 % quantile of the chi-squared distribution of two degrees of freedom: -2 log 0.05.
CHI_SQUARED_95 = -2.0 * math.log(0.05)


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Set of pairs that a fit does not contradict at 95 %.

    Attributes:
        names, units: of the two numbers.
        centre: as fitted, shape (2,).
        covariance: shape (2, 2), positive definite.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    centre: Array
    covariance: Array

    @property
    def correlation(self) -> float:
        """Of the two numbers."""
        return float(self.covariance[0, 1] / math.sqrt(self.covariance[0, 0] * self.covariance[1, 1]))

    @property
    def deviations(self) -> Array:
        """Standard deviation of each, shape (2,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def holds(self, pair: Array) -> bool:
        """Return whether ``pair`` (2,) lies within."""
        apart = np.asarray(pair) - self.centre
        return bool(apart @ np.linalg.solve(self.covariance, apart) <= CHI_SQUARED_95)

    def outline(self, points: int = 181) -> Array:
        """Return points around it, shape (2, points)."""
        angle = np.linspace(0.0, 2.0 * math.pi, points)
        circle = np.array([np.cos(angle), np.sin(angle)])
        root = np.linalg.cholesky(self.covariance)
        return np.asarray(self.centre[:, np.newaxis] + math.sqrt(CHI_SQUARED_95) * root @ circle)
