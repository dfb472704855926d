"""Signal windows: the last second of both channels and its spectrum, every quarter of a second."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_stream.block import Block, Samples
from spool_stream.kernels.compiled import compiled

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class SignalWindow:
    """Signal window: body and spool in the second that ends at ``stamp`` (ns, newest sample).

    ``number`` counts the windows since the last gap. ``samples`` (m/s^2) have the shape (2, n), ``spectrum``
    has (2, n // 2 + 1): the transform of the samples less their means, under a Hann taper, lines ``step`` Hz
    apart. ``means`` (m/s^2) are weighed by that taper; ``energy`` is the sum of its squares.
    """

    stamp: int
    number: int
    samples: Samples
    spectrum: Complex
    means: tuple[float, float]
    step: float
    energy: float


@dataclass(slots=True)
class WindowTracker:
    """Window tracker: the last ``length`` s every ``hop`` s of data; the same for any split into blocks."""

    length: float = 1.0
    hop: float = 0.25
    _last: Samples = field(default_factory=lambda: np.zeros((2, 0), np.float32), init=False)
    _taper: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _weight: float = field(default=0.0, init=False)
    _energy: float = field(default=0.0, init=False)
    _hop: int = field(default=1, init=False)
    _period: float = field(default=0.0, init=False)
    _filled: int = field(default=0, init=False)
    _fresh: int = field(default=0, init=False)
    _number: int = field(default=0, init=False)

    def restart(self, period: float) -> None:
        """Forget all samples; the next ones are ``period`` s apart."""
        if period != self._period:
            size = max(16, round(self.length / period))
            self._hop = max(1, round(self.hop / period))
            # The samples since the last window follow those of it.
            self._last = np.zeros((2, size + self._hop), np.float32)
            self._taper = np.hanning(size).astype(np.float64)
            self._weight, self._energy = float(self._taper.sum()), float(self._taper @ self._taper)
            self._period = period
        self._filled = self._fresh = self._number = 0

    def update(self, block: Block) -> list[SignalWindow]:
        """Take a block; return the windows that fell due."""
        found = []
        size, hop, total = self._taper.size, self._hop, block.body.size
        taken = 0
        while taken < total:
            count = min(hop - self._fresh, total - taken)
            begin = size + self._fresh
            self._last[0, begin : begin + count] = block.body[taken : taken + count]
            self._last[1, begin : begin + count] = block.spool[taken : taken + count]
            taken += count
            self._fresh += count
            if self._fresh < hop:
                break
            self._fresh = 0
            samples = self._last[:, hop:].copy()
            self._last[:, :size] = samples
            self._filled = min(size, self._filled + hop)
            if self._filled == size:
                stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
                found.append(self._window(stamp, samples))
        return found

    def _window(self, stamp: int, samples: Samples) -> SignalWindow:
        tapered, (body, spool) = taper(samples, self._taper)
        spectrum = fft.rfft(tapered)
        more = spectrum[:, 0].real / self._weight
        means = body + float(more[0]), spool + float(more[1])
        step = 1.0 / (self._taper.size * self._period)
        self._number += 1
        return SignalWindow(stamp, self._number - 1, samples, spectrum, means, step, self._energy)


@compiled
def taper(samples: Samples, weights: Array) -> tuple[Array, tuple[float, float]]:
    """Return ``samples`` (shape (2, n)) less their means, times ``weights`` (shape (n,)), and the means.

    A channel that does not move gives zeros, whatever its level.
    """
    size = weights.size
    body = spool = 0.0
    for i in range(size):
        body += float(samples[0, i])
        spool += float(samples[1, i])
    body /= size
    spool /= size
    tapered = np.empty((2, size))
    for i in range(size):
        tapered[0, i] = (samples[0, i] - body) * weights[i]
        tapered[1, i] = (samples[1, i] - spool) * weights[i]
    return tapered, (body, spool)
