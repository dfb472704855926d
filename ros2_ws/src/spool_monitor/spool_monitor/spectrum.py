"""The strongest line of the excitation and what the spool makes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_stream.block import Block, Samples

#: Hz, below lies drift, above no spring of a directional valve resonates.
BAND = (4.0, 250.0)


@dataclass(frozen=True, slots=True)
class Line:
    """The dominant line at ``stamp`` (ns, newest sample).

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


@dataclass(slots=True)
class LineTracker:
    """Look for the dominant line in the last ``window`` s, every ``hop`` s of data.

    ``silent`` holds the stamps (ns) of the looks in the last ``update`` that found no vibration at all.
    """

    window: float = 1.0
    hop: float = 0.25
    silent: list[int] = field(default_factory=list, init=False)
    _last: NDArray[np.float32] = field(default_factory=lambda: np.zeros((2, 0), np.float32), init=False)
    _hop: int = field(default=1, init=False)
    _taper: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)
    _period: float = field(default=0.0, init=False)
    _filled: int = field(default=0, init=False)
    _fresh: int = field(default=0, init=False)
    _waiting: list[tuple[Samples, Samples]] = field(default_factory=list, init=False)

    def restart(self, period: float) -> None:
        """Forget all samples; the next ones are ``period`` s apart."""
        size = max(16, round(self.window / period))
        if size != self._taper.size or period != self._period:
            self._hop = max(1, round(self.hop / period))
            # The samples since the last look follow those of the window, body and spool.
            self._last = np.zeros((2, size + self._hop), np.float32)
            self._taper = np.hanning(size).astype(np.float64)
            self._period = period
        self._filled = self._fresh = 0
        self._waiting.clear()
        self.silent = []

    def update(self, block: Block) -> list[Line]:
        """Take a block; return the lines that fell due, the same for any split into blocks."""
        total = block.body.size
        self.silent = []
        if self._fresh + total < self._hop:
            self._waiting.append((block.body, block.spool))
            self._fresh += total
            return []
        lines = []
        size, hop = self._taper.size, self._hop
        taken = 0
        while taken < total:
            count = min(hop - self._fresh, total - taken)
            part = slice(taken, taken + count)
            self._waiting.append((block.body[part], block.spool[part]))
            taken += count
            self._fresh += count
            if self._fresh < hop:
                break
            self._fresh = 0
            for side in (0, 1):
                self._last[side, size:] = np.concatenate([pair[side] for pair in self._waiting])
            self._waiting.clear()
            self._last[:, :size] = self._last[:, hop:]
            self._filled = min(size, self._filled + hop)
            if self._filled == size:
                stamp = block.stamp + round((taken - 1) * block.sample_period * 1e9)
                line = self._find(stamp)
                if line is None:
                    self.silent.append(stamp)
                else:
                    lines.append(line)
        return lines

    def _find(self, stamp: int) -> Line | None:
        size = self._taper.size
        step = 1.0 / (size * self._period)
        low = max(3, math.ceil(BAND[0] / step))
        high = min(size // 2 - 2, math.floor(BAND[1] / step))
        if high <= low:
            return None
        window = self._last[:, :size]
        means = np.add.reduce(window, axis=1, dtype=np.float64, keepdims=True) / size
        # Two lines beyond the band on either side: a tapered line at its edge spreads so far.
        body, spool = np.fft.rfft((window - means) * self._taper)[:, low - 2 : high + 3]
        power = body.real**2 + body.imag**2
        first = int(power[2:-2].argmax())
        line = power[first : first + 5].tolist()
        line_power = sum(line)
        if line_power <= 0.0 or not math.isfinite(line_power):
            return None
        by_body, by_spool = body[first : first + 5].tolist(), spool[first : first + 5].tolist()
        spool_power = sum(abs(one) ** 2 for one in by_spool)
        relative_power = sum(abs(one - other) ** 2 for one, other in zip(by_spool, by_body, strict=True))
        centre = first + sum(place * share for place, share in enumerate(line)) / line_power
        # The centre of gravity of a Hann-tapered line lies on its frequency.
        frequency = (low - 2 + centre) * step
        # A sine of amplitude A under the taper holds A^2 / 4 times the taper's energy times n.
        scale = 4.0 / (float(self._taper @ self._taper) * self._taper.size)
        return Line(
            stamp=stamp,
            frequency=frequency,
            body=math.sqrt(line_power * scale),
            spool=math.sqrt(spool_power * scale),
            amplification=math.sqrt(spool_power / line_power),
            relative_displacement=math.sqrt(relative_power * scale) / (2.0 * math.pi * frequency) ** 2,
            share=line_power / float(power.sum()),
        )
