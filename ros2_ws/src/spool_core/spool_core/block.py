"""Blocks of samples: one block, runs of blocks that follow each other, and the last samples."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]

#: Sequences and stamps beyond it are left to single blocks: arrays of integers hold no more.
LARGEST = 1 << 62

#: s of data that are looked back on.
RECENT = 60.0


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of samples of both accelerometers.

    ``stamp`` is the acquisition time of the first sample (integer ns), ``sequence`` counts
    blocks since the source started, ``sample_period`` is in s, ``body`` and ``spool`` are
    accelerations in m/s^2 of shape (n,), ``source`` is the ``frame_id`` of the message: the valve's id, empty
    where it is not known. A block holds what arrived; it may be malformed:
    :class:`~spool_core.block_gate.BlockGate` decides. ``blocks`` is how many it was
    joined of, 1 as a rule; ``sequence`` is that of the last one. ``dropped`` is how many blocks ahead of it
    this process has dropped, as it was too busy for them; negative while it started.
    """

    stamp: int
    sequence: int
    sample_period: float
    body: Samples
    spool: Samples
    source: str = ""
    blocks: int = 1
    dropped: int = 0

    @property
    def size(self) -> int:
        """Samples of each channel; 0 where they differ or have none."""
        return self.body.size if self.body.size == self.spool.size else 0

    @property
    def end(self) -> int:
        """Time at which the first sample of the next block is due, ns."""
        return self.stamp + round(self.body.size * self.sample_period * 1e9)

    @property
    def duration(self) -> float:
        """Time from the first sample to the one after the last, s."""
        return self.body.size * self.sample_period


@dataclass(frozen=True, slots=True)
class BlockRun:
    """What many regular blocks say, at the cost of one.

    Block ``n`` of it has the stamp ``stamp + n * step`` (ns), the sequence ``sequence + n`` and the samples
    from ``n * size`` on; period, source and number of samples are those of all. A period that is no whole
    number of nanoseconds makes no runs but of one block.

    Attributes:
        stamp, sequence: of the first block.
        size: samples of a block, at least 1; ``body`` and ``spool`` hold a whole number of times as many.

    """

    stamp: int
    sequence: int
    sample_period: float
    body: Samples
    spool: Samples
    source: str
    size: int

    @classmethod
    def of(cls, block: Block) -> BlockRun | None:
        """Return ``block`` as a run of one, ``None`` where it has no samples or channels of two lengths."""
        if not 0 < block.body.size == block.spool.size:
            return None
        return cls(
            block.stamp, block.sequence, block.sample_period, block.body, block.spool, block.source,
            block.body.size,
        )  # fmt: skip

    def __len__(self) -> int:
        """Return the number of blocks."""
        return self.body.size // self.size

    @property
    def step(self) -> int:
        """Time from block to block, ns."""
        return self.size * round(self.sample_period * 1e9)

    @property
    def last(self) -> Block:
        """The last block."""
        return self.block(len(self) - 1)

    def block(self, number: int) -> Block:
        """Return block ``number``, from 0 on."""
        part = slice(number * self.size, (number + 1) * self.size)
        return Block(
            self.stamp + number * self.step, self.sequence + number, self.sample_period,
            self.body[part], self.spool[part], self.source,
        )  # fmt: skip

    def blocks(self) -> Iterator[Block]:
        """Yield the blocks one by one."""
        return map(self.block, range(len(self)))

    def part(self, first: int, end: int) -> BlockRun:
        """Return the blocks from ``first`` to before ``end`` as a run, which has one block at least."""
        if first == 0 and end == len(self):
            return self
        part = slice(first * self.size, end * self.size)
        return BlockRun(
            self.stamp + first * self.step, self.sequence + first, self.sample_period,
            self.body[part], self.spool[part], self.source, self.size,
        )  # fmt: skip


def last_of(item: Block | BlockRun) -> Block:
    """Return the last block of ``item``."""
    return item.last if isinstance(item, BlockRun) else item


def cut(
    items: Sequence[Block | BlockRun], count: int
) -> tuple[list[Block | BlockRun], list[Block | BlockRun]]:
    """Return the first ``count`` blocks of ``items``, and those behind them."""
    for place, item in enumerate(items):
        size = len(item) if isinstance(item, BlockRun) else 1
        if count < size:
            ahead, behind = list(items[:place]), list(items[place:])
            if count > 0 and isinstance(item, BlockRun):
                ahead.append(item.part(0, count))
                behind[0] = item.part(count, size)
            return ahead, behind
        count -= size
    return list(items), []


def joined(items: Sequence[Block | BlockRun]) -> Block:
    """Return blocks that follow each other without a gap as one; ``sequence`` is that of the last one."""
    first = items[0]
    one = len(items) == 1
    if one and isinstance(first, Block):
        return first
    return Block(
        first.stamp,
        last_of(items[-1]).sequence,
        first.sample_period,
        first.body if one else np.concatenate([item.body for item in items]),
        first.spool if one else np.concatenate([item.spool for item in items]),
        first.source,
        sum(len(item) if isinstance(item, BlockRun) else item.blocks for item in items),
    )


@dataclass(slots=True)
class RecentCounts:
    """Blocks lost and refused in the last RECENT s, by steps of 1 s; its user advances the clock."""

    lost: int = 0
    refused: int = 0
    _clock: float = 0.0
    _steps: deque[list[int]] = field(default_factory=deque)

    def advance(self, seconds: float) -> None:
        """Advance the clock; forget counts that are older than RECENT."""
        self._clock += seconds
        while self._steps and self._steps[0][0] < self._clock - RECENT:
            _, lost, refused = self._steps.popleft()
            self.lost -= lost
            self.refused -= refused

    def count(self, lost: int, refused: int) -> None:
        """Count blocks that were lost or refused now."""
        now = int(self._clock)
        if not self._steps or self._steps[-1][0] != now:
            self._steps.append([now, 0, 0])
        self._steps[-1][1] += lost
        self._steps[-1][2] += refused
        self.lost += lost
        self.refused += refused
