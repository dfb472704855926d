"""Blocks as a bag holds them: decoded many at once, put in order, and limited to a stretch.

The messages of a source have one layout as long as its blocks have one length: fields that then lie at
the same places are compared and copied for all of them in a few steps.
"""

from __future__ import annotations

import functools
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from spool_core.block import LARGEST, Block, BlockRun
from spool_core.block_gate import LONGEST_PERIOD
from spool_core.cdr import LITTLE_ENDIAN, NANOSECONDS, CdrError, Reading, decode_block

#: Messages below which each is decoded by itself: comparing them all costs as much.
FEW = 8

#: ns by which a message may be late and is still put in its place.
WINDOW = 5_000_000_000
#: Messages, and B of them, that are held at most: 10 s of 2000 messages a second, or of 8 MB a second.
LONGEST_QUEUE = 20_000
LARGEST_QUEUE = 80_000_000
#: B of all valves together, and what a message costs on top of its bytes (its arrays and objects).
LARGEST_QUEUES = 4 * LARGEST_QUEUE
OVERHEAD = 1000

Item = Block | BlockRun | Reading

_STAMP, _KEY = itemgetter(0), itemgetter(0, 1, 2)

#: ns by which times of reception may lie behind or ahead of the sensors' stamps: a part that begins or ends
#: so close to a span is read as well.
APART = 60_000_000_000
#: Beyond any stamp, ns.
ALWAYS = 1 << 62


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


class Keyed(NamedTuple):
    """Item with its sort key: stamp (ns), sequence and arrival; ``size`` in B of a message.

    A run is as many messages as it has blocks, each with its own key, ``step`` ns apart.
    """

    stamp: int
    sequence: int
    arrival: int
    item: Item
    size: int
    messages: int = 1
    step: int = 0

    @property
    def last(self) -> int:
        """Stamp of the last message, ns."""
        return self.stamp + (self.messages - 1) * self.step

    @property
    def weight(self) -> int:
        """What a message costs, B."""
        return self.size + OVERHEAD

    def before(self, key: tuple[int, int, int]) -> int:
        """Return how many of the messages come before ``key`` (stamp, sequence, arrival)."""
        if self[:3] >= key:
            return 0
        if self.messages == 1:
            return 1
        whole = min(max((key[0] - self.stamp) // self.step, 0), self.messages)
        at = self.stamp + whole * self.step, self.sequence + whole, self.arrival
        return min(whole + (at < key), self.messages)

    def cut(self, count: int) -> tuple[Keyed, Keyed | None]:
        """Return the first ``count`` messages, and the others, where there are any."""
        if count >= self.messages or not isinstance(self.item, BlockRun):
            return self, None
        first, rest = self.item.part(0, count), self.item.part(count, self.messages)
        left = self.messages - count
        return (
            self._replace(item=first, messages=count),
            self._replace(stamp=rest.stamp, sequence=rest.sequence, item=rest, messages=left),
        )


def keyed_of(item: Item, arrival: int, size: int, count: int) -> Keyed:
    """Return an item with its key; ``count`` messages of ``size`` B each, the ``arrival``-th to arrive."""
    if isinstance(item, Reading):
        return Keyed(item.stamp, -1, arrival, item, size)
    step = item.step if isinstance(item, BlockRun) else 0
    return Keyed(item.stamp, item.sequence, arrival, item, size, count, step)


@dataclass(slots=True)
class OrderingWindow:
    """Reordering window of one valve: items that may still be overtaken; an older stamp starts again."""

    _queue: list[Keyed] = field(default_factory=list)
    _lowest: int = 0
    _highest: int = 0
    _held: int = 0
    size: int = 0

    def room(self, keyed: Keyed) -> int:
        """Return how many messages of ``keyed`` can be taken until something is due, 1 at least."""
        if keyed.messages == 1:
            return 1
        again = not self._queue or keyed.stamp < self._highest - WINDOW
        lowest, held, size = (keyed.stamp, 0, 0) if again else (self._lowest, self._held, self.size)
        late = (2 * WINDOW + min(lowest, keyed.stamp) - keyed.stamp) // keyed.step + 1
        most = min(late, LONGEST_QUEUE - held, (LARGEST_QUEUE - size) // keyed.weight)
        return min(keyed.messages, max(0, most) + 1)

    def take(self, keyed: Keyed) -> list[Keyed]:
        """Take an item, of a run what there is ``room`` for; return those due, in order of their keys."""
        due: list[Keyed] = []
        stamp = keyed.stamp
        if not self._queue:
            self._lowest = self._highest = stamp
        elif stamp < self._highest - WINDOW:
            due = self.rest()
            self._lowest = self._highest = stamp
        elif stamp < self._lowest:
            self._lowest = stamp
        self._highest = max(self._highest, keyed.last)
        self._queue.append(keyed)
        self._held += keyed.messages
        self.size += keyed.messages * keyed.weight
        full = self._held > LONGEST_QUEUE or self.size > LARGEST_QUEUE
        if full or self._highest - self._lowest > 2 * WINDOW:
            due += self.split(full=full)
        return due

    def rest(self) -> list[Keyed]:
        """Return what is still held, in order."""
        due, self._queue, self._held, self.size = _ordered(self._queue), [], 0, 0
        return due

    def split(self, *, full: bool) -> list[Keyed]:
        """Return what cannot be overtaken any more, half of what is held at least where it is ``full``."""
        queue, bound = _ordered(self._queue), self._highest - WINDOW
        end = bisect_left(queue, bound, key=_STAMP)
        leaving = sum(keyed.messages for keyed in queue[:end])
        if end:
            leaving -= queue[end - 1].messages - queue[end - 1].before((bound, -1, -1))
        leaving = max(leaving, (self._held + 1) // 2) if full else leaving
        self._held -= leaving
        due: list[Keyed] = []
        at = 0
        while leaving:
            first, rest = queue[at].cut(leaving)
            due.append(first)
            leaving -= first.messages
            self.size -= first.messages * first.weight
            if rest is None:
                at += 1
            else:
                queue[at] = rest
        self._queue = queue[at:]
        self._lowest = self._queue[0].stamp if self._queue else self._highest
        return due


@dataclass(slots=True)
class OrderingWindows:
    """Reordering windows, one for each valve; together they hold ``LARGEST_QUEUES`` at most."""

    _windows: dict[str, OrderingWindow] = field(default_factory=dict)
    _size: int = 0

    def take(self, valve: str, keyed: Keyed) -> Iterator[tuple[str, Item]]:
        """Take an item of ``valve`` and yield what is due of it."""
        window = self._windows.get(valve)
        if window is None:
            window = self._windows[valve] = OrderingWindow()
        left: Keyed | None = keyed
        while left is not None:
            room = window.room(left)
            if left.messages > 1:
                room = min(room, max(LARGEST_QUEUES - self._size, 0) // left.weight + 1)
            now, left = left.cut(room)
            self._size += now.messages * now.weight
            for held in window.take(now):
                self._size -= held.messages * held.weight
                yield valve, held.item
            if self._size > LARGEST_QUEUES:
                for name, other in self._windows.items():
                    for held in other.split(full=True) if other.size else ():
                        self._size -= held.messages * held.weight
                        yield name, held.item

    def rest(self) -> Iterator[tuple[str, Item]]:
        """Yield what is still held, valve by valve."""
        for valve, window in self._windows.items():
            for held in window.rest():
                yield valve, held.item


@dataclass(frozen=True, slots=True)
class Span:
    """Span of time: stamps from ``since`` to before ``until``, ns since 1970; all by default."""

    since: int = -ALWAYS
    until: int = ALWAYS

    @property
    def is_all(self) -> bool:
        """Whether nothing is left out."""
        return self.since <= -ALWAYS and self.until >= ALWAYS

    def touches(self, first: int, last: int) -> bool:
        """Return whether a part with messages received from ``first`` to ``last`` (ns) may touch it."""
        return last >= self.since - APART - WINDOW and first <= self.until + APART + WINDOW

    def holds(self, stamp: int) -> bool:
        """Return whether ``stamp`` lies in it."""
        return self.since <= stamp < self.until

    def cut(self, item: Item) -> Iterator[tuple[Item, int]]:
        """Yield what of an item lies in it, with its number of messages."""
        if not isinstance(item, BlockRun):
            if self.holds(item.stamp):
                yield item, 1
            return
        count, step = len(item), max(item.step, 1)
        first = min(max(0, -(-(self.since - item.stamp) // step)), count)
        end = min(max(0, -(-(self.until - item.stamp) // step)), count)
        if first < end:
            yield item.part(first, end), end - first


def _like(first: Block, messages: Sequence[bytes]) -> Iterator[Block | BlockRun]:
    """Yield ``first``, of the first of ``messages``, and those behind it that have its layout."""
    nanoseconds = first.sample_period * 1e9
    regular = 0 < first.body.size == first.spool.size and 1.0 <= nanoseconds <= 1e9 * LONGEST_PERIOD
    regular = regular and nanoseconds.is_integer() and 0 <= first.sequence < LARGEST
    if len(messages) < FEW or not regular or messages[0][:4] != LITTLE_ENDIAN:
        yield first
        return
    step = first.body.size * int(nanoseconds)  # ns from block to block
    layout = _layout(int.from_bytes(messages[0][12:16], "little"), first.body.size, len(messages[0]))
    rows = np.frombuffer(b"".join(messages), layout)
    # Those that have all that makes a layout, and sequences that fit.
    alike = (rows["sequence"] < LARGEST) & (rows["count"] == rows["count"][0])
    for name in ("mark", "name", "period"):
        alike &= (rows[name] == rows[name][0]).all(axis=1)
    alike &= rows["other_count"] == rows["count"][0]
    same = rows.size if alike.all() else int(np.argmin(alike))
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


def _ordered(queue: list[Keyed]) -> list[Keyed]:
    """Return ``queue`` in the order of the keys; a run that others come between is cut there."""
    queue = sorted(queue, key=_KEY)
    if all(one.messages == 1 or one.before(_KEY(other)) == one.messages for one, other in pairwise(queue)):
        return queue
    found = []
    heapify(queue)
    while queue:
        first = heappop(queue)
        if first.messages > 1 and queue:
            first, rest = first.cut(first.before(_KEY(queue[0])))
            if rest is not None:
                heappush(queue, rest)
        found.append(first)
    return found
