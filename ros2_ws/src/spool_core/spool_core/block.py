"""Block of samples, which every consumer of the suite takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Block:
    """Block: a stretch of samples of both accelerometers.

    ``stamp`` is the acquisition time of the first sample (integer ns), ``sequence`` counts
    blocks since the source started, ``sample_period`` is in s, ``body`` and ``spool`` are
    accelerations in m/s^2 of shape (n,), ``source`` is the ``frame_id`` of the message: the valve's id, empty
    where it is not known. A block holds what arrived; it may be malformed:
    :class:`~spool_core.block_gate.BlockGate` decides. ``blocks`` is how many it was
    joined of, 1 as a rule; ``sequence`` is that of the last one.
    """

    stamp: int
    sequence: int
    sample_period: float
    body: Samples
    spool: Samples
    source: str = ""
    blocks: int = 1

    @property
    def end(self) -> int:
        """Time at which the first sample of the next block is due, ns."""
        return self.stamp + round(self.body.size * self.sample_period * 1e9)


def joined(blocks: Sequence[Block]) -> Block:
    """Return blocks that follow each other without a gap as one; ``sequence`` is that of the last one."""
    if len(blocks) == 1:
        return blocks[0]
    return Block(
        blocks[0].stamp,
        blocks[-1].sequence,
        blocks[0].sample_period,
        np.concatenate([block.body for block in blocks]),
        np.concatenate([block.spool for block in blocks]),
        blocks[0].source,
        sum(block.blocks for block in blocks),
    )
