"""Run of blocks: blocks of one length that follow each other to the nanosecond, as one stretch of samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .block import Block, Samples

#: Sequences and stamps beyond it are left to single blocks: arrays of integers hold no more.
LARGEST = 1 << 62


@dataclass(frozen=True, slots=True)
class BlockRun:
    """Run of blocks: what many regular blocks say, at the cost of one.

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


def joined_runs(runs: Sequence[BlockRun]) -> Block:
    """Return runs that follow each other without a gap as one block; ``sequence`` is that of the last one."""
    first, last = runs[0], runs[-1]
    one = len(runs) == 1
    return Block(
        first.stamp,
        last.sequence + len(last) - 1,
        first.sample_period,
        first.body if one else np.concatenate([run.body for run in runs]),
        first.spool if one else np.concatenate([run.spool for run in runs]),
        first.source,
        sum(map(len, runs)),
    )
