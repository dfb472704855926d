"""Bayesian online change point detection, a peer of the drift test.

Adams and MacKay, Bayesian online changepoint detection, 2007 (arXiv:0710.3742): the posterior of the run
length (values since the last change) by a recursion over all run lengths. Values of one
run are normal around a level that is normal around 0 beforehand, both standard deviations known (conjugate).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Run lengths that are less likely than this are left out; the recursion stays short.
NEGLIGIBLE = 1e-12


class ChangePoints:
    """Posterior of run length and level.

    Args:
        hazard: probability of a change at any value.
        scatter: standard deviation of values around their level.
        prior: standard deviation of levels around 0.

    Attributes:
        lengths: run lengths that are left, shape (r,).
        weights: their posterior probabilities, shape (r,).
    """

    def __init__(self, hazard: float, scatter: float, prior: float = 1.0) -> None:
        self.lengths: NDArray[np.int64] = np.zeros(1, dtype=np.int64)
        self.weights: Array = np.ones(1)
        self._hazard, self._noise, self._prior = hazard, scatter**-2, prior**-2
        self._sums: Array = np.zeros(1)
        self._count = 0

    def update(self, value: float) -> None:
        """Take ``value``."""
        precision = self._prior + self._noise * self.lengths
        expected = self._noise * self._sums / precision
        variance = 1.0 / precision + 1.0 / self._noise
        exponent = -0.5 * ((value - expected) ** 2 / variance + np.log(variance))
        joint = self.weights * np.exp(exponent - exponent.max())
        grown, changed = (1.0 - self._hazard) * joint, self._hazard * joint.sum()
        # With a change this value is the last of its run: the next one begins with nothing.
        weights = np.concatenate([[changed], grown])
        weights /= weights.sum()
        left = weights > NEGLIGIBLE
        self.lengths = np.concatenate([[0], self.lengths + 1])[left]
        self._sums = np.concatenate([[0.0], self._sums + value])[left]
        self.weights = weights[left] / weights[left].sum()
        self._count += 1

    @property
    def changed(self) -> float:
        """The probability that there was any change since the first value."""
        return 1.0 - float(self.weights[self.lengths == self._count].sum())

    @property
    def level(self) -> float:
        """The mean of the posterior of the present run's level."""
        precision = self._prior + self._noise * self.lengths
        return float(np.sum(self.weights * self._noise * self._sums / precision))
