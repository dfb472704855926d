"""Chunk window: the last chunks, how well any parameters fit there, and how well given ones do."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]
Counts = NDArray[np.int64]


class WindowArrays(NamedTuple):
    """Arrays of a :class:`ChunkWindow`, which kernels move on in place."""

    grams: Array
    products: Array
    powers: Array


@dataclass(slots=True)
class ChunkWindow:
    """Chunk window: sums of ``length`` chunks; ``scale``, shape (p,), makes parameters of order one."""

    scale: Array
    length: int = 10
    count: int = field(default=0, init=False)
    _grams: Array = field(init=False)
    _products: Array = field(init=False)
    _powers: Array = field(init=False)
    _verdict: Array = field(init=False)

    def __post_init__(self) -> None:
        size = self.scale.size
        self._grams = np.zeros((self.length, size, size))
        self._products = np.zeros((self.length, size))
        self._powers = np.zeros((self.length, 2))
        self._verdict = np.zeros(3 + size)

    def add(self, rows: Array, target: Array) -> None:
        """Take a chunk: ``rows`` of shape (n, p), ``target`` of shape (n,)."""
        scaled = rows * self.scale
        self.add_sums(
            scaled.T @ scaled,
            scaled.T @ target,
            float(target @ target),
            target.size,
            np.zeros(self.scale.size),
        )

    @property
    def arrays(self) -> WindowArrays:
        """What the kernels move on in place; ``count`` is their caller's."""
        return WindowArrays(self._grams, self._products, self._powers)

    def add_sums(self, gram: Array, score: Array, power: float, samples: float, parameters: Array) -> None:
        """Take a chunk by its sums over scaled rows: row row^T, row error, error^2, at ``parameters``."""
        _add(
            self._grams, self._products, self._powers, self.count % self.length,
            gram, score, power, samples, parameters / self.scale,
        )  # fmt: skip
        self.count += 1

    def take(
        self, gram: Array, score: Array, power: float, samples: float, parameters: Array, lasts: Counts
    ) -> list[list[float]]:
        """Take a chunk as ``add_sums`` does and return what ``judge`` says then, for each of ``lasts``."""
        verdicts = np.empty((lasts.size, 3 + self.scale.size))
        take_chunk(
            self.arrays, self.count, gram, score, power, samples, parameters / self.scale, lasts, verdicts
        )
        self.count += 1
        return [verdict[:3] for verdict in verdicts.tolist()]

    def clear(self) -> None:
        """Forget all chunks."""
        self.count = 0

    @property
    def full(self) -> bool:
        """Whether as many chunks as the window is long have been seen since it was cleared."""
        return self.count >= self.length

    def best(self, last: int | None = None) -> Array:
        """Return what fits the ``last`` chunks (all) best, shape (p,); the smallest if several do."""
        return np.asarray(self._judge(np.zeros(self.scale.size), last)[3:] * self.scale)

    def variances(self, parameters: Array, last: int | None = None) -> tuple[float, float]:
        """Return the residual variances of ``parameters`` and of the best fit to ``last`` chunks (all)."""
        present, own, _ = self.judge(parameters, last)
        return present, own

    def judge(self, parameters: Array, last: int | None = None) -> tuple[float, float, float]:
        """Return the same and the number of samples in those chunks."""
        verdict = self._judge(parameters, last)
        return float(verdict[0]), float(verdict[1]), float(verdict[2])

    def _judge(self, parameters: Array, last: int | None) -> Array:
        known = min(self.count, self.length)
        _judge(
            self._grams, self._products, self._powers, self.count,
            min(known, last) if last else known, parameters / self.scale, self._verdict,
        )  # fmt: skip
        return self._verdict


@compiled
def _add(
    grams: Array,
    products: Array,
    powers: Array,
    place: int,
    gram: Array,
    score: Array,
    power: float,
    samples: float,
    given: Array,
) -> None:
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
def _judge(
    grams: Array, products: Array, powers: Array, count: int, last: int, given: Array, verdict: Array
) -> None:
    """Fill ``verdict``: variance of ``given``, of the best fit, samples, the best fit..."""
    size = given.size
    gram = np.zeros((size, size))
    product = np.zeros(size)
    power = 0.0
    samples = 0.0
    for back in range(1, last + 1):
        place = (count - back) % grams.shape[0]
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
    tiny = 1e-12 * abs(power)
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


@compiled
def take_chunk(
    window: WindowArrays,
    count: int,
    gram: Array,
    score: Array,
    power: float,
    samples: float,
    given: Array,
    lasts: Counts,
    verdicts: Array,
) -> None:
    """Take a chunk into a window that has seen ``count``, and fill ``verdicts`` for each of ``lasts``."""
    grams, products, powers = window
    length = grams.shape[0]
    _add(grams, products, powers, count % length, gram, score, power, samples, given)
    for which in range(lasts.size):
        last = min(count + 1, length, lasts[which])
        _judge(grams, products, powers, count + 1, last, given, verdicts[which])
