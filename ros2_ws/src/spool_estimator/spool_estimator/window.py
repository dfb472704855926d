"""The last second of chunks: how well any parameters fit there, and how well given ones do."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Moments:
    gram: Array
    product: Array
    power: float
    samples: int


@dataclass(slots=True)
class ChunkWindow:
    """Sums of the last ``length`` chunks, ``scale`` (shape (p,)) making the parameters of order one."""

    scale: Array
    length: int = 10
    _chunks: deque[_Moments] = field(init=False)

    def __post_init__(self) -> None:
        self._chunks = deque(maxlen=self.length)

    def add(self, rows: Array, target: Array) -> None:
        """Take a chunk: ``rows`` of shape (n, p), ``target`` of shape (n,)."""
        scaled = rows * self.scale
        self._chunks.append(
            _Moments(scaled.T @ scaled, scaled.T @ target, float(target @ target), target.size)
        )

    def clear(self) -> None:
        """Forget all chunks."""
        self._chunks.clear()

    @property
    def full(self) -> bool:
        """Whether as many chunks as the window is long have been seen since it was cleared."""
        return len(self._chunks) == self.length

    def best(self) -> Array:
        """Return the parameters that fit the window best, shape (p,); the smallest where several do."""
        gram = sum((one.gram for one in self._chunks), np.zeros((self.scale.size, self.scale.size)))
        product = sum((one.product for one in self._chunks), np.zeros(self.scale.size))
        return np.asarray(np.linalg.pinv(gram, hermitian=True) @ product * self.scale)

    def variances(self, parameters: Array) -> tuple[float, float]:
        """Return the residual variances of ``parameters`` and of the window's own best fit."""
        gram = sum((one.gram for one in self._chunks), np.zeros((self.scale.size, self.scale.size)))
        product = sum((one.product for one in self._chunks), np.zeros(self.scale.size))
        power = sum(one.power for one in self._chunks)
        count = max(1, sum(one.samples for one in self._chunks))
        given = parameters / self.scale
        # A singular window is fitted by the smallest parameters that explain it.
        best = np.linalg.pinv(gram, hermitian=True) @ product
        present = power - 2.0 * float(given @ product) + float(given @ gram @ given)
        own = power - float(best @ product)
        tiny = 1e-12 * power
        return max(present, tiny) / count, max(own, tiny) / count
