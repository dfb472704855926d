"""Recursive least squares with exponential forgetting, sample by sample.

Ljung, System Identification, 1999, section 11.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]


@dataclass(slots=True)
class ExponentialForgetting:
    """Exponential forgetting: an error of target = row . parameters counts ``factor`` times less a sample.

    Args:
        size: number of parameters p.
        factor: forgetting factor, above 0 to 1; 1 - T / t for a memory of t s at a sample period of T s.
        initial: diagonal of the covariance at the start, in units of the error's variance.
        largest: a sum of the diagonal beyond which nothing more is forgotten, so that hours without
            excitation do not wind it up.

    Attributes:
        parameters: shape (p,).
        covariance: of the parameters in units of the error's variance, shape (p, p).
        errors: weighted means of the squared error before the update and of its product with the one before,
            and the sum of their weights, shape (3,).
        samples: taken since the start.

    """

    size: int
    factor: float
    initial: float = 1.0e4
    largest: float = math.inf
    parameters: Array = field(init=False)
    covariance: Array = field(init=False)
    errors: Array = field(init=False)
    samples: int = field(default=0, init=False)
    _gain: Array = field(init=False)

    def __post_init__(self) -> None:
        self.parameters = np.zeros(self.size)
        self.covariance = np.eye(self.size) * self.initial
        self.errors = np.zeros(3)
        self._gain = np.zeros(self.size + 1)

    def update(self, rows: Array, target: Array) -> None:
        """Take ``rows`` of shape (n, p) and ``target`` of shape (n,), sample after sample."""
        _take(
            np.ascontiguousarray(rows), target, self.factor, self.largest,
            self.parameters, self.covariance, self.errors, self._gain,
        )  # fmt: skip
        self.samples += target.size

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the parameters, shape (p,).

        The error counts as one of first order: where it resembles the one before, there are fewer
        independent samples. At steady state they are high by a factor of up to the root of 2.
        """
        square, product, _ = self.errors
        likeness = min(0.999, max(0.0, product / square)) if square > 0.0 else 0.0
        variance = square * (1.0 + likeness) / (1.0 - likeness)
        return np.asarray(np.sqrt(variance * np.maximum(np.diag(self.covariance), 0.0)))


@compiled
def _take(
    rows: Array,
    target: Array,
    factor: float,
    largest: float,
    parameters: Array,
    covariance: Array,
    errors: Array,
    gain: Array,
) -> None:
    size = parameters.size
    before = gain[size]
    for n in range(target.size):
        error = target[n]
        for i in range(size):
            error -= rows[n, i] * parameters[i]
            gain[i] = 0.0
        # The covariance is symmetric: columns are read as rows, which lie together.
        for j in range(size):
            x = rows[n, j]
            for i in range(size):
                gain[i] += covariance[j, i] * x
        seen = factor
        trace = 0.0
        for i in range(size):
            seen += rows[n, i] * gain[i]
            trace += covariance[i, i]
        growth = 1.0 / factor if trace < largest else 1.0
        inverse = 1.0 / seen
        for i in range(size):
            share = gain[i] * inverse
            parameters[i] += share * error
            # Rounding that is not symmetric would grow as the covariance does, without end.
            for j in range(i + 1):
                value = growth * (covariance[i, j] - share * gain[j])
                covariance[i, j] = value
                covariance[j, i] = value
        errors[2] = factor * errors[2] + 1.0
        errors[0] += (error * error - errors[0]) / errors[2]
        errors[1] += (error * before - errors[1]) / errors[2]
        before = error
    gain[size] = before
