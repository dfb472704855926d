"""Window of least squares over the newest chunks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

Counts = NDArray[np.int64]


class WindowArrays(NamedTuple):
    """Arrays of a :class:`ChunkWindow`, which kernels move on in place; ``taken``: chunks, shape (1,)."""

    taken: Counts
    grams: Array
    products: Array
    powers: Array


@dataclass(slots=True)
class ChunkWindow:
    """Sums of ``length`` chunks; ``scale``, shape (p,), makes parameters of order one."""

    scale: Array
    length: int = 10
    _taken: Counts = field(init=False)
    _grams: Array = field(init=False)
    _products: Array = field(init=False)
    _powers: Array = field(init=False)

    def __post_init__(self) -> None:
        size = self.scale.size
        self._taken = np.zeros(1, np.int64)
        self._grams = np.zeros((self.length, size, size))
        self._products = np.zeros((self.length, size))
        self._powers = np.zeros((self.length, 2))

    @property
    def arrays(self) -> WindowArrays:
        """What the kernels move on in place."""
        return WindowArrays(self._taken, self._grams, self._products, self._powers)

    def add_sums(self, gram: Array, score: Array, power: float, samples: float, parameters: Array) -> None:
        """Take a chunk by its sums over scaled rows: row row^T, row error, error^2, at ``parameters``."""
        _add(self.arrays, gram, score, power, samples, parameters / self.scale)

    def clear(self) -> None:
        """Forget all chunks."""
        self._taken[0] = 0

    def best(self, last: int | None = None) -> Array:
        """Return what fits the ``last`` chunks (all) best, shape (p,); the smallest if several do."""
        verdict = np.zeros(3 + self.scale.size)
        _judge(self.arrays, last or self.length, np.zeros(self.scale.size), verdict)
        return np.asarray(verdict[3:] * self.scale)


@compiled
def take_chunk(
    window: WindowArrays,
    gram: Array,
    score: Array,
    power: float,
    samples: float,
    given: Array,
    lasts: Counts,
    verdicts: Array,
) -> None:
    """Take a chunk into a window, and fill ``verdicts`` for each of ``lasts``."""
    _add(window, gram, score, power, samples, given)
    for which in range(lasts.size):
        _judge(window, lasts[which], given, verdicts[which])


@compiled
def _add(window: WindowArrays, gram: Array, score: Array, power: float, samples: float, given: Array) -> None:
    taken, grams, products, powers = window
    place = taken[0] % grams.shape[0]
    taken[0] += 1
    powers[place, 1] = samples
    for i in range(given.size):
        along = 0.0
        for j in range(given.size):
            grams[place, i, j] = gram[i, j]
            along += gram[i, j] * given[j]
        products[place, i] = score[i] + along
        power += given[i] * (2.0 * score[i] + along)
    powers[place, 0] = power


@compiled
def _judge(window: WindowArrays, last: int, given: Array, verdict: Array) -> None:
    """Fill ``verdict`` from the ``last`` chunks: variance of ``given``, of the best fit, samples, the fit."""
    taken, grams, products, powers = window
    size = given.size
    gram = np.zeros((size, size))
    product = np.zeros(size)
    power = 0.0
    samples = 0.0
    for back in range(1, min(taken[0], grams.shape[0], last) + 1):
        place = (taken[0] - back) % grams.shape[0]
        for i in range(size):
            product[i] += products[place, i]
            for j in range(size):
                gram[i, j] += grams[place, i, j]
        power += powers[place, 0]
        samples += powers[place, 1]
    # A singular window is fitted by the smallest parameters that explain it.
    trace = np.trace(gram)
    for i in range(size):
        gram[i, i] += 1e-15 * trace + 1e-300
    verdict[3:] = np.linalg.solve(gram, product)
    tiny = 1e-12 * abs(power) + 1e-300  # chunks of which no sample counts leave nothing
    divisor = max(1.0, samples)
    left = least = power
    for i in range(size):
        least -= verdict[3 + i] * product[i]
        left -= 2.0 * given[i] * product[i]
        for j in range(size):
            left += given[i] * gram[i, j] * given[j]
    verdict[0] = max(left, tiny) / divisor
    verdict[1] = min(float(verdict[0]), max(least, tiny) / divisor)
    verdict[2] = samples
