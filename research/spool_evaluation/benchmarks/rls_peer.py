"""Recursive least squares as textbooks print it, compiled: a peer that is not held back by Python.

P <- (P - P x x' P / (f + x' P x)) / f, theta <- theta + P x e / (f + x' P x): Ljung, System Identification,
1999, section 11.2. It keeps no statistics of its errors and does not limit P, which ours does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]


class CompiledRls:
    """Recursive least squares of target = row . parameters, with forgetting ``factor``.

    The covariance starts at ``initial``.

    Attributes:
        parameters: shape (p,).
        covariance: shape (p, p).
    """

    def __init__(self, size: int, factor: float, initial: float) -> None:
        self.parameters: Array = np.zeros(size)
        self.covariance: Array = np.eye(size) * initial
        self._factor = factor

    def update(self, rows: Array, target: Array) -> None:
        """Take ``rows`` of shape (n, p) and ``target`` of shape (n,), sample after sample."""
        _take(rows, target, self._factor, self.parameters, self.covariance)


@compiled
def _take(rows: Array, target: Array, factor: float, parameters: Array, covariance: Array) -> None:
    size = parameters.size
    gain = np.zeros(size)
    for n in range(target.size):
        error = target[n]
        seen = factor
        for i in range(size):
            error -= rows[n, i] * parameters[i]
            total = 0.0
            for j in range(size):
                total += covariance[i, j] * rows[n, j]
            gain[i] = total
            seen += rows[n, i] * total
        for i in range(size):
            parameters[i] += gain[i] / seen * error
            for j in range(size):
                covariance[i, j] = (covariance[i, j] - gain[i] * gain[j] / seen) / factor
