"""Window of the last seconds of both channels, and its spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy import fft
from spool_core.block import Block, Samples
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array, Complex

#: Hz, below lies drift, above no spring of a directional valve resonates.
BAND = (4.0, 250.0)


class SignalWindow(NamedTuple):
    """Body and spool in the second that ends at ``stamp`` (ns, newest sample).

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
    """The last ``length`` s every ``hop`` s of data; the same for any split into blocks."""

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
    _left_out: bool = field(default=False, init=False)

    @property
    def fresh(self) -> int:
        """Samples of a window that the one before it has not."""
        return self._hop

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

    def update(self, block: Block, *, thinned: bool = False) -> list[SignalWindow]:
        """Take a block; return the windows that fell due; ``thinned``: the last one in every other block."""
        size, hop, total, fresh = self._taper.size, self._hop, block.body.size, self._fresh
        if fresh + total < hop:
            place = slice(size + fresh, size + fresh + total)
            self._last[0, place], self._last[1, place] = block.body, block.spool
            self._fresh += total
            return []
        hops = (fresh + total) // hop
        # Until a second is full no window is.
        few = min(hops, max(0, -(-(size - self._filled) // hop) - 1))
        if thinned:
            self._left_out = not self._left_out
            few = hops if self._left_out else max(few, hops - 1)
        self._fresh, self._filled = (fresh + total) % hop, min(size, self._filled + hops * hop)
        samples = np.empty((hops - few, 2, size), np.float32)
        tapered, means = np.empty((hops - few, 2, size)), np.empty((hops - few, 2))
        cut(block.body, block.spool, self._last, fresh, few, self._taper, samples, tapered, means)
        if few == hops:
            return []
        spectra = fft.rfft(tapered)
        means += spectra[:, :, 0].real / self._weight
        step = 1.0 / (size * self._period)
        found = []
        for window, (body, spool) in enumerate(means.tolist()):
            last = (few + window + 1) * hop - fresh - 1
            stamp = block.stamp + round(last * block.sample_period * 1e9)
            found.append(
                SignalWindow(
                    stamp, self._number, samples[window], spectra[window], (body, spool), step, self._energy
                )
            )
            self._number += 1
        return found


@compiled
def cut(
    body: Samples,
    spool: Samples,
    last: Samples,
    fresh: int,
    few: int,
    weights: Array,
    samples: Samples,
    tapered: Array,
    means: Array,
) -> None:
    """Take samples of shape (n,) behind those in ``last``, and fill the windows that fall due with them.

    ``last``, shape (2, size + hop), holds a window and the samples since, of which ``fresh`` are new; the
    first ``few`` windows are not full and left out. ``samples`` and ``tapered`` have shape
    (windows, 2, size), ``means`` has (windows, 2).
    """
    size = weights.size
    hop = last.shape[1] - size
    place, hops = size + fresh, 0
    for i in range(body.size):
        last[0, place], last[1, place] = body[i], spool[i]
        place += 1
        if place < size + hop:
            continue
        for j in range(size):
            last[0, j], last[1, j] = last[0, j + hop], last[1, j + hop]
        if hops >= few:
            window = hops - few
            samples[window] = last[:, :size]
            means[window, 0], means[window, 1] = taper(samples[window], weights, tapered[window])
        place = size
        hops += 1


@compiled
def taper(samples: Samples, weights: Array, tapered: Array) -> tuple[float, float]:
    """Fill ``tapered`` with ``samples`` less their means, times ``weights``, shape (n,); return the means.

    ``samples`` and ``tapered`` have shape (2, n). A channel that does not move gives zeros, whatever its
    level.
    """
    size = weights.size
    body = spool = 0.0
    for i in range(size):
        body += float(samples[0, i])
        spool += float(samples[1, i])
    body /= size
    spool /= size
    for i in range(size):
        tapered[0, i] = (samples[0, i] - body) * weights[i]
        tapered[1, i] = (samples[1, i] - spool) * weights[i]
    return body, spool


class Line(NamedTuple):
    """Line of the spectrum: the dominant one at ``stamp`` (ns, newest sample).

    ``frequency`` in Hz, ``body`` and ``spool`` peak accelerations in m/s^2, ``amplification`` spool over
    body, ``relative_displacement`` peak in m of the spool in the body, ``share`` of the body's power in the
    band that the line holds.
    """

    stamp: int
    frequency: float
    body: float
    spool: float
    amplification: float
    relative_displacement: float
    share: float


def find_line(window: SignalWindow) -> Line | None:
    """Return the dominant line, ``None`` where nothing shakes."""
    step, size = window.step, window.samples.shape[1]
    low = max(3, math.ceil(BAND[0] / step))
    high = min(size // 2 - 2, math.floor(BAND[1] / step))
    if high <= low:
        return None
    place, body, spool, relative, whole = strongest(window.spectrum, low, high)
    if body <= 0.0 or not math.isfinite(body):
        return None
    frequency = place * step
    # A sine of amplitude A under the taper holds A^2 / 4 times the taper's energy times n.
    scale = 4.0 / (window.energy * size)
    return Line(
        stamp=window.stamp,
        frequency=frequency,
        body=math.sqrt(body * scale),
        spool=math.sqrt(spool * scale),
        amplification=math.sqrt(spool / body),
        relative_displacement=math.sqrt(relative * scale) / (2.0 * math.pi * frequency) ** 2,
        share=body / whole,
    )


@compiled
def strongest(spectrum: Complex, low: int, high: int) -> tuple[float, float, float, float, float]:
    """Return the place (in lines) of the body's strongest line from ``low`` to ``high``, and powers.

    Those are of the body, the spool and the difference of both in it, and of the body in the band; two lines
    beyond the band on either side belong to it: a tapered line at its edge spreads so far.
    """
    peak, most, whole = low, -1.0, 0.0
    for i in range(low - 2, high + 3):
        power = spectrum[0, i].real ** 2 + spectrum[0, i].imag ** 2
        whole += power
        if low <= i <= high and power > most:
            peak, most = i, power
    body = spool = relative = moment = 0.0
    for i in range(peak - 2, peak + 3):
        one, other = spectrum[0, i], spectrum[1, i]
        power = one.real**2 + one.imag**2
        body += power
        spool += other.real**2 + other.imag**2
        relative += (other.real - one.real) ** 2 + (other.imag - one.imag) ** 2
        moment += (i - peak) * power
    # The centre of gravity of a Hann-tapered line lies on its frequency.
    place = peak + moment / body if body > 0.0 else float(peak)
    return place, body, spool, relative, whole
