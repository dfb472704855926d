"""What both channels themselves show, window by window: levels, means, flat tops, cross-spectra."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_estimator.flat_top import flat_share
from spool_stream.block import Block

Array = NDArray[np.float64]

#: Hz, the band of the spectra; the upper end is 0.4 of the sample rate where that is less.
BAND = (3.0, 200.0)


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel in a window: ``mean`` and ``rms`` (about the mean) in m/s^2.

    ``flat_top`` is the share of samples that lie on a flat top at the upper or lower extreme, 0 where the
    extremes are those of a wave; ``constant`` whether no sample differs from another.
    """

    mean: float
    rms: float
    flat_top: float
    constant: bool


@dataclass(frozen=True, slots=True)
class Signals:
    """Both channels in the window that ends at ``stamp`` (ns, newest sample).

    ``frequency`` (Hz), ``body_power``, ``spool_power`` ((m/s^2)^2 per line) and ``cross`` (spool times
    conjugate of body) have shape (lines,); the powers of a stationary signal add to its mean square.
    """

    stamp: int
    body: Channel
    spool: Channel
    frequency: Array
    body_power: Array
    spool_power: Array
    cross: NDArray[np.complex128]

    @property
    def relative_rms(self) -> float:
        """Relative acceleration of the spool in the body within the band, m/s^2 rms."""
        power = self.spool_power + self.body_power - 2.0 * self.cross.real
        return math.sqrt(max(0.0, float(power.sum())))

    @property
    def relative_velocity(self) -> float:
        """Velocity of the spool in the body within the band, m/s rms."""
        power = self.spool_power + self.body_power - 2.0 * self.cross.real
        return math.sqrt(max(0.0, float(np.sum(power / (2.0 * math.pi * self.frequency) ** 2))))

    @property
    def dissipation(self) -> float:
        """Damping, 1/s, that the energy of the relative motion shows: power Re(S conj(V)) over -abs(V)^2.

        V = (S - B) / (j w) is the relative velocity. Negative where the channels can't belong to a passive
        valve, 0 where they have nothing in common, NaN where nothing moves.
        """
        w = 2.0 * math.pi * self.frequency
        squared = float(np.sum((self.spool_power + self.body_power - 2.0 * self.cross.real) / w**2))
        return -float(np.sum(self.cross.imag / w)) / squared if squared > 0.0 else math.nan


@dataclass(slots=True)
class SignalTracker:
    """Look at the last ``window`` s, every ``hop`` s of data; the same for any split into blocks."""

    window: float = 1.0
    hop: float = 0.5
    _last: NDArray[np.float32] = field(default_factory=lambda: np.zeros((2, 0), np.float32), init=False)
    _taper: Array = field(default_factory=lambda: np.zeros(0), init=False)
    _hop: int = field(default=1, init=False)
    _period: float = field(default=0.0, init=False)
    _filled: int = field(default=0, init=False)
    _fresh: int = field(default=0, init=False)

    def restart(self, period: float) -> None:
        """Forget all samples; the next ones are ``period`` s apart."""
        size = max(16, round(self.window / period))
        self._hop = max(1, round(self.hop / period))
        # The samples since the last look follow those of the window.
        self._last = np.zeros((2, size + self._hop), np.float32)
        self._taper = np.hanning(size).astype(np.float64)
        self._period = period
        self._filled = self._fresh = 0

    def update(self, block: Block) -> list[Signals]:
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
            self._last[:, :size] = self._last[:, hop:]
            self._filled = min(size, self._filled + hop)
            if self._filled == size:
                found.append(self._look(block.stamp + round((taken - 1) * block.sample_period * 1e9)))
        return found

    def _look(self, stamp: int) -> Signals:
        size = self._taper.size
        window = self._last[:, :size].astype(np.float64)
        means = window @ self._taper / self._taper.sum()
        centred = window - means[:, np.newaxis]
        body, spool = np.fft.rfft(centred * self._taper)
        step = 1.0 / (size * self._period)
        low = max(1, math.ceil(BAND[0] / step))
        high = min(body.size - 1, math.floor(min(BAND[1], 0.4 / self._period) / step))
        lines = slice(low, max(low, high) + 1)
        body, spool = body[lines], spool[lines]
        # Mean square by Parseval: two-sided, the taper's energy taken out.
        scale = 2.0 / (size * float(self._taper @ self._taper))
        return Signals(
            stamp=stamp,
            body=_channel(window[0], float(means[0])),
            spool=_channel(window[1], float(means[1])),
            frequency=np.arange(lines.start, lines.start + body.size) * step,
            body_power=scale * np.abs(body) ** 2,
            spool_power=scale * np.abs(spool) ** 2,
            cross=scale * spool * np.conj(body),
        )


def _channel(samples: Array, mean: float) -> Channel:
    low, high = float(samples.min()), float(samples.max())
    rms = float(np.sqrt(np.mean((samples - mean) ** 2)))
    return Channel(mean, rms, flat_share(samples), high == low)
