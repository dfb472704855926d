"""CDR of many AccelerationBlocks at once: those that follow each other to the nanosecond are read as one run.

The messages of a source have one layout as long as its blocks have one length: fields that then lie at
the same places are compared and copied for all of them in a few steps.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from spool_core.block import LARGEST, Block, BlockRun
from spool_core.block_gate import LONGEST_PERIOD
from spool_core.cdr import LITTLE_ENDIAN, NANOSECONDS, CdrError, decode_block

#: Messages below which each is decoded by itself: comparing them all costs as much.
FEW = 8


def decode_blocks(messages: Sequence[bytes]) -> Iterator[tuple[Block | BlockRun | None, int]]:
    """Yield the blocks of ``messages``, CDR of one length, and how many messages each result took.

    Regular blocks come as runs; ``None`` is a message that is not what its type says.
    """
    at = 0
    while at < len(messages):
        try:
            block = decode_block(messages[at])
        except CdrError:
            yield None, 1
            at += 1
            continue
        for found in _like(block, messages[at:]):
            yield found, len(found) if isinstance(found, BlockRun) else 1
            at += len(found) if isinstance(found, BlockRun) else 1


def _like(first: Block, messages: Sequence[bytes]) -> Iterator[Block | BlockRun]:
    """Yield ``first``, of the first of ``messages``, and those behind it that have its layout."""
    step = _step(first)
    if len(messages) < FEW or not step or messages[0][:4] != LITTLE_ENDIAN:
        yield first
        return
    layout = _layout(int.from_bytes(messages[0][12:16], "little"), first.body.size, len(messages[0]))
    rows = np.frombuffer(b"".join(messages), layout)
    same = _same(rows)
    stamps = rows["seconds"].astype(np.int64) * NANOSECONDS + rows["nanoseconds"]
    sequences = rows["sequence"].astype(np.int64)
    follows = (np.diff(stamps[:same]) == step) & (np.diff(sequences[:same]) == 1)
    edges = [0, *(np.flatnonzero(~follows) + 1).tolist(), same]
    body, spool = rows["body"], rows["spool"]
    for begin, end in pairwise(edges):
        if end - begin == 1:
            yield first if begin == 0 else decode_block(messages[begin])
            continue
        yield BlockRun(
            int(stamps[begin]),
            int(sequences[begin]),
            first.sample_period,
            body[begin:end].astype(np.float32).reshape(-1),
            spool[begin:end].astype(np.float32).reshape(-1),
            first.source,
            first.body.size,
        )


def _step(block: Block) -> int:
    """Return the time (ns) from such a block to the next one, 0 where that is no whole number."""
    nanoseconds = block.sample_period * 1e9
    regular = 0 < block.body.size == block.spool.size and 1.0 <= nanoseconds <= 1e9 * LONGEST_PERIOD
    if not (regular and nanoseconds.is_integer() and 0 <= block.sequence < LARGEST):
        return 0
    return block.body.size * int(nanoseconds)


def _same(rows: NDArray[np.void]) -> int:
    """Return how many of ``rows`` from the first on have all that makes a layout, and sequences that fit."""
    same = (rows["sequence"] < LARGEST) & (rows["count"] == rows["count"][0])
    for name in ("mark", "name", "period"):
        same &= (rows[name] == rows[name][0]).all(axis=1)
    same &= rows["other_count"] == rows["count"][0]
    return rows.size if same.all() else int(np.argmin(same))


@functools.lru_cache(maxsize=64)
def _layout(name: int, samples: int, length: int) -> np.dtype[np.void]:
    """Return where the fields lie in a message of ``length`` B with a ``frame_id`` of ``name`` B."""
    at = ((12 + name + 7) & ~7) + 4
    fields = {
        "mark": ("u1", (4,), 0),
        "seconds": ("<i4", (), 4),
        "nanoseconds": ("<u4", (), 8),
        "name": ("u1", (at - 12,), 12),
        "sequence": ("<u8", (), at),
        "period": ("u1", (8,), at + 8),
        "count": ("<u4", (), at + 16),
        "body": ("<f4", (samples,), at + 20),
        "other_count": ("<u4", (), at + 20 + 4 * samples),
        "spool": ("<f4", (samples,), at + 24 + 4 * samples),
    }
    return np.dtype(
        {
            "names": list(fields),
            "formats": [(kind, shape) for kind, shape, _ in fields.values()],
            "offsets": [offset for _, _, offset in fields.values()],
            "itemsize": length,
        }
    )
