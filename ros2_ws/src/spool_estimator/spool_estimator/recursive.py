"""Recursive least squares with forgetting, in chunks of samples.

Least squares in information form: chunks of samples add their Gram matrix, forgetting takes information away.
Forgetting is directional: along each principal direction of the new chunk at most as much is forgotten as
the chunk brings, so that a parameter that the machine does not excite is held with its certainty
(Cao and Schwartz, Automatica 36 (2000) 1725, extended from a sample to a chunk).

The covariance is the sandwich form for dependent residuals, carried through the same recursion
(Liang and Zeger, Biometrika 73 (1986) 13, a chunk being a cluster).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True)
class RecursiveLeastSquares:
    """Fit target = row . parameters; all state is readable.

    Args:
        scale: typical size of each parameter, shape (p,); the prior has this standard deviation about zero.
        forgetting: share of information that a fully excited chunk replaces, 0 to 1.
        noise: standard deviation of the target that the prior is weighed with.

    """

    scale: Array
    forgetting: float
    noise: float
    parameters: Array = field(init=False)
    information: Array = field(init=False)
    covariance: Array = field(init=False)
    chunks: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.parameters = np.zeros(self.scale.size)
        # All in units of ``scale``, so that one step of algebra serves any mix of units.
        self.information = np.eye(self.scale.size) * self.noise**2
        self.covariance = np.eye(self.scale.size)

    def update(self, rows: Array, target: Array) -> None:
        """Take a chunk: ``rows`` of shape (n, p), ``target`` of shape (n,)."""
        scaled = rows * self.scale
        gram = scaled.T @ scaled
        current = self.parameters / self.scale
        score = scaled.T @ (target - scaled @ current)
        kept = self._forget(gram)
        inverse = np.linalg.inv(kept + gram)
        shrink = inverse @ kept
        current = current + inverse @ score
        # The part of the score that the fit could not explain, between before and after the step.
        left = inverse @ score
        self.covariance = shrink @ self.covariance @ shrink.T + np.outer(left, left)
        self.information = kept + gram
        self.parameters = current * self.scale
        self.chunks += 1

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the parameters, shape (p,)."""
        return np.sqrt(np.diag(self.covariance)) * self.scale

    def _forget(self, gram: Array) -> Array:
        """Return the information less what the chunk replaces, direction by direction."""
        factor = np.linalg.cholesky(self.information)
        inverse = np.linalg.inv(factor)
        shares, directions = np.linalg.eigh(inverse @ gram @ inverse.T)
        forgotten = np.clip(shares, 0.0, self.forgetting)
        basis = factor @ directions
        return (basis * (1.0 - forgotten)) @ basis.T
