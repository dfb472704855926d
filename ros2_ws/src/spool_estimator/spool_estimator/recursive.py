"""Recursive least squares with directional forgetting.

Information form (Ljung, System Identification, 1999, section 11.2): chunks add Gram matrices, forgetting
takes information away. Along each principal direction of a chunk at most as much is forgotten as it brings,
so that a parameter that the machine does not excite is held with its certainty (directional forgetting: Cao
and Schwartz, Automatica 36 (2000) 1725, extended from a sample to a chunk).

The covariance is the sandwich form for dependent residuals, carried through the same recursion
(Liang and Zeger, Biometrika 73 (1986) 13, a chunk being a cluster; neighbours within LAGS chunks may depend
on each other, with Bartlett's weights: Newey and West, Econometrica 55 (1987) 703).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

Matrix = NDArray[np.floating]

#: Chunks over which residuals may depend on each other.
LAGS = 4
#: Certainty (in units of the scale) beyond which a direction may be forgotten faster than the chunk replaces
#: it, up to AHEAD times: what a strong excitation once said must not outweigh minutes of a weak one.
ENOUGH, AHEAD = 0.003, 300.0
#: Squares of deviations of errors that a resonance colours, over white ones; deviations that are not chance.
COLOURED, CERTAIN = 40.0, 3.0


class RegressionArrays(NamedTuple):
    """Arrays of a least-squares recursion, which kernels move on in place."""

    parameters: Array
    information: Array
    covariance: Array
    recent: Array
    bias: Array
    leaks: Array


@dataclass(slots=True)
class RecursiveLeastSquares:
    """Recursive least squares of target = row . parameters; all state is readable.

    Args:
        scale: typical size of each parameter, shape (p,); the prior has this standard deviation about zero.
        forgetting: share of information that a fully excited chunk replaces, 0 to 1.
        noise: standard deviation of the target that the prior is weighed with.

    Attributes:
        leaks: element i, j: the error of parameter i, in units of its scale, if only parameter j moves, as
            its estimates do: samples from before the move are explained by a wrong mixture of both.

    """

    scale: Array
    forgetting: float
    noise: float
    parameters: Array = field(init=False)
    information: Array = field(init=False)
    covariance: Array = field(init=False)
    bias: Array = field(init=False)
    leaks: Array = field(init=False)
    _recent: Array = field(init=False)

    def __post_init__(self) -> None:
        self.parameters = np.zeros(self.scale.size)
        # All in units of ``scale``, so that one step of algebra serves any mix of units.
        self.information = np.eye(self.scale.size) * self.noise**2
        self.covariance = np.eye(self.scale.size)
        self.bias = np.zeros(self.scale.size)
        self.leaks = np.zeros((self.scale.size, self.scale.size))
        self._recent = np.zeros((LAGS, self.scale.size))

    @property
    def arrays(self) -> RegressionArrays:
        """What the kernels move on in place."""
        return RegressionArrays(
            self.parameters, self.information, self.covariance, self._recent, self.bias, self.leaks
        )

    def copy(self) -> RecursiveLeastSquares:
        """Return a recursion that goes on from here by itself."""
        other = RecursiveLeastSquares.__new__(RecursiveLeastSquares)
        other.scale, other.forgetting, other.noise = self.scale, self.forgetting, self.noise
        other.parameters, other.information = self.parameters.copy(), self.information.copy()
        other.covariance, other.bias = self.covariance.copy(), self.bias.copy()
        other._recent, other.leaks = self._recent.copy(), self.leaks.copy()
        return other

    def begin(self, parameters: Array, grams: Array, scores: Array, mean_score: Array) -> None:
        """Begin again with ``parameters`` that fit n chunks.

        ``grams`` (n, p, p) and ``scores`` (n, p) are as for ``advance``, but weighted;
        ``mean_score`` is that of all, (p,).
        """
        self.parameters = np.array(parameters)
        self.information = grams.sum(axis=0) + np.eye(self.scale.size) * self.noise**2
        self.covariance = sandwich(self.information, scores)
        self.bias = np.asarray(np.linalg.solve(self.information, mean_score), dtype=np.float64)
        self._recent[:] = self.leaks[:] = 0.0
        if self.forgetting > 0.0:
            self.information *= min(1.0, 1.0 / (len(grams) * self.forgetting))

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the parameters, shape (p,)."""
        return np.sqrt(np.diag(self.covariance)) * self.scale


def sandwich(information: Array, scores: Array) -> Array:
    """Return the covariance for n chunks' scores, shape (n, p), neighbours within LAGS dependent."""
    inverse = np.linalg.inv(information)
    padded = np.pad(scores, ((LAGS - 1, LAGS - 1), (0, 0)))
    sums = sum((padded[lag : lag + len(scores) + LAGS - 1] for lag in range(LAGS)), np.zeros(scores.shape[1]))
    count, size = scores.shape
    meat = sums.T @ sums / LAGS * (count / max(1, count - size))
    return np.asarray(inverse @ meat @ inverse)


@compiled
def advance(
    regression: RegressionArrays,
    gram: Array,
    score: Array,
    mean_score: Array,
    weight: float,
    forgetting: float,
    noise: float,
    change: Array,
) -> None:
    """Forget, add the chunk, fill ``change`` of the parameters, which stay; all else moves on in place.

    ``gram`` and ``score`` are sums over scaled rows: row row^T, and row times the present error; each sample
    counts ``weight``. ``mean_score`` is the part of ``score`` that a known cause makes, for ``bias``.
    """
    _, information, covariance, recent, bias, leaks = regression
    size = score.size
    gram = weight * gram
    factor = np.linalg.cholesky(information)
    inverse = np.linalg.inv(factor)
    shares, directions = np.linalg.eigh(times(times(inverse, gram), inverse.T))
    basis = times(factor, directions)
    dual = times(inverse.T, directions)
    kept = np.zeros((size, size))
    leaked = times(basis.T, leaks * (1.0 - np.eye(size)))
    chance = times(times(basis.T, covariance), basis)
    for i in range(size):
        brought = max(shares[i], 0.0)
        # A displacement along ``dual`` has its length times the noise as nominal deviation.
        excess = 1.0 - (dual[:, i] ** 2).sum() * (noise / ENOUGH) ** 2
        forgotten = min(forgetting, max(brought, min(AHEAD * brought, excess)))
        # What leaks make more wrong than chance does must not weigh as if it were wrong by chance alone.
        believed = CERTAIN**2 * max(chance[i, i], COLOURED * noise**2)
        forgotten = max(forgotten, 1.0 - believed / max(believed, (leaked[i] ** 2).sum()))
        for j in range(size):
            for k in range(size):
                kept[j, k] += (1.0 - forgotten) * basis[j, i] * basis[k, i]
    information[:] = kept + gram
    gain = np.linalg.inv(information)
    shrink = times(gain, kept)
    change[:] = 0.0
    former = bias.copy()
    bias[:] = 0.0
    for i in range(size):
        for j in range(size):
            change[i] += gain[i, j] * weight * score[j]
            bias[i] += shrink[i, j] * former[j] + gain[i, j] * weight * mean_score[j]
    for i in range(size):
        leaks[i, i] -= change[i]
    leaks[:] = times(shrink, leaks)
    neighbours = np.zeros(size)
    for lag in range(recent.shape[0] - 1):
        for i in range(size):
            recent[lag, i] = 0.0
            for j in range(size):
                recent[lag, i] += shrink[i, j] * recent[lag + 1, j]
            neighbours[i] += (lag + 1.0) / recent.shape[0] * recent[lag, i]
    recent[-1] = change
    covariance[:] = times(times(shrink, covariance), shrink.T)
    for i in range(size):
        for j in range(size):
            across = neighbours[i] * change[j] + change[i] * neighbours[j]
            covariance[i, j] += change[i] * change[j] + across


@compiled
def times(one: Matrix, other: Matrix) -> Array:
    """Return the product of two small square matrices: loops, for what BLAS costs per call is more."""
    size = one.shape[0]
    product = np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            for k in range(size):
                product[i, j] += one[i, k] * other[k, j]
    return product
