"""Recursive least squares with forgetting, in chunks of samples.

Least squares in information form: chunks of samples add their Gram matrix, forgetting takes information away.
Forgetting is directional: along each principal direction of the new chunk at most as much is forgotten as
the chunk brings, so that a parameter that the machine does not excite is held with its certainty
(Cao and Schwartz, Automatica 36 (2000) 1725, extended from a sample to a chunk).

The covariance is the sandwich form for dependent residuals, carried through the same recursion
(Liang and Zeger, Biometrika 73 (1986) 13, a chunk being a cluster). The first chunks are solved as one batch:
before there is a fit, a residual is the signal itself and says nothing of the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Chunks that are solved together before the recursion begins.
BATCH = 10


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
    _first: list[tuple[Array, Array]] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.parameters = np.zeros(self.scale.size)
        # All in units of ``scale``, so that one step of algebra serves any mix of units.
        self.information = np.eye(self.scale.size) * self.noise**2
        self.covariance = np.eye(self.scale.size)

    def update(self, rows: Array, target: Array, weight: float = 1.0) -> None:
        """Take a chunk: ``rows`` of shape (n, p), ``target`` of shape (n,); a sample counts ``weight``."""
        scaled = rows * self.scale
        gram = scaled.T @ scaled * weight
        product = scaled.T @ target * weight
        self.chunks += 1
        if self.chunks <= BATCH:
            self._solve_batch(gram, product)
        else:
            self._step(gram, product)

    def _step(self, gram: Array, product: Array) -> None:
        current = self.parameters / self.scale
        score = product - gram @ current
        kept = self._forget(gram)
        inverse = np.linalg.inv(kept + gram)
        shrink = inverse @ kept
        change = inverse @ score
        self.covariance = shrink @ self.covariance @ shrink.T + np.outer(change, change)
        self.information = kept + gram
        self.parameters = (current + change) * self.scale

    def _solve_batch(self, gram: Array, product: Array) -> None:
        """Solve for all chunks so far; the covariance comes from their residual scores."""
        self._first.append((gram, product))
        prior = np.eye(self.scale.size) * self.noise**2
        self.information = prior + sum((one for one, _ in self._first), np.zeros_like(prior))
        inverse = np.linalg.inv(self.information)
        solution = inverse @ sum((one for _, one in self._first), np.zeros(self.scale.size))
        scores = np.array([product - gram @ solution for gram, product in self._first])
        count, size = scores.shape
        if count > size:
            meat = scores.T @ scores * (count / (count - size)) + prior
            self.covariance = inverse @ meat @ inverse
        self.parameters = solution * self.scale
        if count == BATCH:
            self._first.clear()
            # No more than forgetting would have left, else a memory shorter than the batch is never reached.
            self.information *= min(1.0, 1.0 / (BATCH * self.forgetting)) if self.forgetting > 0.0 else 1.0

    def discount(self, share: float) -> None:
        """Take ``share`` of the information away in every direction: the past has become less true."""
        self.information *= 1.0 - share
        self.covariance /= 1.0 - share

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
        return np.asarray((basis * (1.0 - forgotten)) @ basis.T)
