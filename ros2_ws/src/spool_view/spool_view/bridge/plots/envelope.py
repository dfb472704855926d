"""Envelope of a waveform: least and largest sample of each interval, so that decimation loses no peak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block

Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class EnvelopePoint:
    """Envelope of an interval that begins at ``stamp`` (ns): bounds of both channels, m/s^2."""

    stamp: int
    body: tuple[float, float]
    spool: tuple[float, float]


class Envelope:
    """Envelope of the blocks of one valve at a rate; keeps less than one interval of samples."""

    def __init__(self, rate: float) -> None:
        """Give ``rate`` points a second."""
        self._rate = rate
        self._body: Array = np.zeros(0, dtype=np.float32)
        self._spool: Array = np.zeros(0, dtype=np.float32)
        self._sequence = -1

    def update(self, block: Block) -> list[EnvelopePoint]:
        """Return the intervals that ``block`` completes; what a lost or malformed one cut off is left out."""
        if block.body.size != block.spool.size or not block.sample_period > 0.0:
            self._sequence = -1
            return []
        if block.sequence != self._sequence + 1:
            self._body = self._spool = np.zeros(0, dtype=np.float32)
        self._sequence = block.sequence
        width = max(1, round(1.0 / (self._rate * block.sample_period)))
        before = self._body.size
        body, spool = np.concatenate([self._body, block.body]), np.concatenate([self._spool, block.spool])
        count = body.size // width
        whole = count * width
        self._body, self._spool = body[whole:].copy(), spool[whole:].copy()
        bounds = [
            (rows.min(axis=1), rows.max(axis=1))
            for rows in (row[:whole].reshape(count, width) for row in (body, spool))
        ]
        first = block.stamp - round(1e9 * before * block.sample_period)
        return [
            EnvelopePoint(
                first + round(1e9 * number * width * block.sample_period),
                (float(bounds[0][0][number]), float(bounds[0][1][number])),
                (float(bounds[1][0][number]), float(bounds[1][1][number])),
            )
            for number in range(count)
        ]
