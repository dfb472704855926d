"""Records of any length in bounded memory: parts spread over the time, those with more motion first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict

from .record import Record

#: Samples of both channels that are held at most.
LARGEST = 700_000
#: s, and samples at least, of a part.
PART, LEAST = 12.0, 4096


@dataclass(slots=True)
class _Part:
    """Samples without a gap; ``cut``: what is ahead of them was left out or lies in another part."""

    start: int
    period: float
    cut: bool
    body: list[NDArray[np.float32]] = field(default_factory=list)
    spool: list[NDArray[np.float32]] = field(default_factory=list)
    size: int = 0

    def take(self, block: Block) -> None:
        self.body.append(block.body)
        self.spool.append(block.spool)
        self.size += block.body.size

    @property
    def length(self) -> int:
        """Samples of a part of this sample period."""
        return max(round(PART / self.period), LEAST)

    def level(self) -> float:
        """Return the motion of the body, m/s^2 rms."""
        return float(np.concatenate(self.body).astype(np.float64).std())

    def pieces(self) -> list[_Part]:
        """Return this cut into parts of their length; the last may be shorter."""
        length = self.length
        if self.size <= length:
            return [self]
        body, spool = np.concatenate(self.body), np.concatenate(self.spool)
        found = []
        for first in range(0, self.size, length):
            piece = _Part(self.start + round(first * self.period * 1e9), self.period, self.cut or first > 0)
            part = slice(first, first + length)
            piece.body, piece.spool = [body[part].copy()], [spool[part].copy()]
            piece.size = piece.body[0].size
            found.append(piece)
        return found


@dataclass(slots=True)
class PartKeeper:
    """Takes blocks; holds all samples while they fit, else parts spread evenly over the whole time.

    Where ``largest`` is exceeded, long stretches are cut into parts of ``PART`` s, and of each two parts in a
    row the one with more motion stays; of what comes then one of two is kept, later one of four.

    Attributes:
        largest: samples that are held, about.
    """

    largest: int = LARGEST
    _gate: BlockGate = field(default_factory=BlockGate, init=False)
    _origin: int = field(default=0, init=False)
    _parts: list[_Part] = field(default_factory=list, init=False)
    _open: _Part | None = field(default=None, init=False)
    _rivals: list[_Part] = field(default_factory=list, init=False)
    _every: int = field(default=1, init=False)
    _came: int = field(default=0, init=False)
    _held: int = field(default=0, init=False)

    def take(self, block: Block) -> None:
        """Take the next block; a faulty one is left out as online."""
        verdict = self._gate.judge(block)
        if verdict is Verdict.REFUSED:
            return
        if self._open is None:
            self._origin = block.stamp
        fresh = verdict is Verdict.RESTARTS or self._open is None
        full = self._open is not None and self._every > 1 and self._open.size >= self._open.length
        if fresh or full:
            self._close()
            self._open = _Part(block.stamp, block.sample_period, cut=not fresh)
        assert self._open is not None
        self._open.take(block)
        if self._held + self._open.size > self.largest:
            self._thin()

    def records(self, name: str, temperatures: Iterable[tuple[int, float]] = ()) -> list[Record]:
        """Return what is held, in order of time.

        Args:
            name: of the recording.
            temperatures: stamps (ns) and oil temperatures (deg C), in order of time; linear in between.
        """
        known = [pair for pair in temperatures if np.isfinite(pair[1])]
        stamps, degrees = np.array([pair[0] for pair in known]), np.array([pair[1] for pair in known])
        found = []
        for part in (*self._parts, *self._rivals, *([] if self._open is None else [self._open])):
            body, spool = (np.concatenate(rows).astype(np.float64) for rows in (part.body, part.spool))
            oil = None
            if known:
                oil = np.interp(part.start + np.arange(body.size) * part.period * 1e9, stamps, degrees)
            found.append(Record(name, part.start, part.period, body, spool, oil, self._origin, part.cut))
        return found

    def _close(self) -> None:
        """Let the part that is complete compete with those that came with it."""
        if self._open is None:
            return
        self._rivals = [_loudest([*self._rivals, self._open])] if self._every > 1 else []
        self._came += 1
        if self._came >= self._every:
            self._parts += self._rivals or [self._open]
            self._rivals, self._came = [], 0
        self._count()

    def _thin(self) -> None:
        pieces = [piece for part in (*self._parts, *self._rivals) for piece in part.pieces()]
        assert self._open is not None
        *more, self._open = self._open.pieces()
        pieces += more
        self._parts = [_loudest(pieces[place : place + 2]) for place in range(0, len(pieces), 2)]
        self._rivals, self._came = [], 0
        self._every *= 2
        self._count()

    def _count(self) -> None:
        self._held = sum(part.size for part in (*self._parts, *self._rivals))


def _loudest(parts: list[_Part]) -> _Part:
    """Return the part with most motion; a gap ahead of any of them is one ahead of it."""
    found = max(parts, key=_Part.level)
    found.cut = all(part.cut for part in parts)
    return found
