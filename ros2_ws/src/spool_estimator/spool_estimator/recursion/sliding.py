"""Least squares over a sliding window of chunks: what is older than the window is forgotten completely."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .recursive import RegressionArrays, sandwich

Array = NDArray[np.float64]


@dataclass(slots=True)
class SlidingLeastSquares:
    """Least squares of the last ``length`` chunks; takes and gives what ``RecursiveLeastSquares`` does.

    Args:
        scale: typical size of each parameter, shape (p,); a weak prior has this standard deviation.
        length: chunks in the window.
        noise: standard deviation of the target that the prior is weighed with.

    """

    scale: Array
    length: int
    noise: float
    parameters: Array = field(init=False)
    information: Array = field(init=False)
    chunks: int = field(default=0, init=False)
    _kept: deque[tuple[Array, Array, Array]] = field(init=False)

    def __post_init__(self) -> None:
        self.parameters = np.zeros(self.scale.size)
        self.information = np.eye(self.scale.size) * self.noise**2
        self._kept = deque(maxlen=self.length)

    @property
    def arrays(self) -> RegressionArrays:
        """What kernels look at; they leave it as it is, for a window is moved on by ``advance`` alone."""
        nothing = np.zeros((self.scale.size, self.scale.size))
        return RegressionArrays(self.parameters, self.information, nothing, nothing, nothing[0])

    def copy(self) -> SlidingLeastSquares:
        """Return least squares that go on from here by themselves."""
        other = SlidingLeastSquares(self.scale, self.length, self.noise)
        other.parameters, other.information = self.parameters.copy(), self.information.copy()
        other.chunks, other._kept = self.chunks, self._kept.copy()
        return other

    def advance(self, gram: Array, score: Array, mean_score: Array, weight: float = 1.0) -> Array:
        """Take a chunk by its sums over scaled rows: row row^T, and row times the present error.

        ``mean_score`` is the part of ``score`` that a known cause makes on average: it goes into ``bias``.
        Each sample counts ``weight``.

        Returns:
            The change of the parameters, shape (p,).

        """
        present = self.parameters / self.scale
        self.chunks += 1
        if not np.any(gram):
            return np.zeros(self.scale.size)
        self._kept.append((weight * gram, weight * (score + gram @ present), weight * mean_score))
        return self._solve(present)

    def begin(self, parameters: Array, grams: Array, scores: Array, mean_score: Array) -> None:
        """Begin anew with ``parameters`` that fit n chunks.

        ``grams`` (n, p, p) and ``scores`` (n, p) are as for ``advance``, but weighted;
        ``mean_score`` is that of all, (p,).
        """
        given = parameters / self.scale
        self.parameters = np.array(parameters)
        self.chunks += len(grams)
        self._kept.clear()
        mean = mean_score / len(grams)
        self._kept.extend(
            (gram, score + gram @ given, mean) for gram, score in zip(grams, scores, strict=True)
        )
        self.information = sum((gram for gram, _, _ in self._kept), np.eye(given.size) * self.noise**2)

    def _solve(self, present: Array) -> Array:
        # A weak pull towards the present parameters: what the window cannot tell stays as it is.
        prior = np.eye(present.size) * self.noise**2
        self.information = sum((gram for gram, _, _ in self._kept), prior)
        product = sum((one for _, one, _ in self._kept), prior @ present)
        moved = (np.linalg.solve(self.information, product) - present) * self.scale
        self.parameters = self.parameters + moved
        return np.asarray(moved)

    @property
    def bias(self) -> Array:
        """Mean error that the known causes make, in units of ``scale``, shape (p,)."""
        total = sum((mean for _, _, mean in self._kept), np.zeros(self.scale.size))
        return np.asarray(np.linalg.solve(self.information, total), dtype=np.float64)

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, in units of ``scale``, shape (p, p)."""
        present = self.parameters / self.scale
        if len(self._kept) <= self.scale.size:
            return np.eye(self.scale.size)
        return sandwich(self.information, np.array([one - gram @ present for gram, one, _ in self._kept]))

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the parameters, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)) * self.scale)
