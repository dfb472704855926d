"""Reordering of messages by acquisition time within a window, with bounded memory."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from typing import NamedTuple

from spool_stream.block import Block

from spool_bag.format.cdr import OilTemperature

#: ns by which a message may be late and is still put in its place.
WINDOW = 5_000_000_000
#: Messages, and B of them, that are held at most: 10 s of 2000 messages a second, or of 8 MB a second.
LONGEST_QUEUE = 20_000
LARGEST_QUEUE = 80_000_000
#: B of all valves together, and what a message costs on top of its own bytes (its arrays and objects).
LARGEST_QUEUES = 4 * LARGEST_QUEUE
OVERHEAD = 1000

Item = Block | OilTemperature


class Keyed(NamedTuple):
    """Item with its sort key: its stamp (ns) and sequence; ``size`` in B of the message."""

    stamp: int
    sequence: int
    item: Item
    size: int


_STAMP, _KEY = itemgetter(0), itemgetter(0, 1)


@dataclass(slots=True)
class OrderingWindow:
    """Reordering window of one valve: items that may still be overtaken; a stamp further back starts anew."""

    _queue: list[Keyed] = field(default_factory=list)
    _lowest: int = 0
    _highest: int = 0
    size: int = 0

    def take(self, keyed: Keyed) -> list[Keyed]:
        """Take an item and return those that are due, in order of (stamp, sequence, arrival)."""
        due: list[Keyed] = []
        stamp = keyed.stamp
        if not self._queue:
            self._lowest = self._highest = stamp
        elif stamp > self._highest:
            self._highest = stamp
        elif stamp < self._highest - WINDOW:
            due = self.rest()
            self._lowest = self._highest = stamp
        elif stamp < self._lowest:
            self._lowest = stamp
        self._queue.append(keyed)
        self.size += keyed.size + OVERHEAD
        full = len(self._queue) > LONGEST_QUEUE or self.size > LARGEST_QUEUE
        if full or self._highest - self._lowest > 2 * WINDOW:
            due += self.split(full=full)
        return due

    def rest(self) -> list[Keyed]:
        """Return what is still held, in order."""
        due, self._queue, self.size = sorted(self._queue, key=_KEY), [], 0
        return due

    def split(self, *, full: bool) -> list[Keyed]:
        """Return what cannot be overtaken any more, half of what is held at least where it is ``full``."""
        self._queue.sort(key=_KEY)
        split = bisect_left(self._queue, self._highest - WINDOW, key=_STAMP)
        split = max(split, (len(self._queue) + 1) // 2) if full else split
        due = self._queue[:split]
        del self._queue[:split]
        self.size -= sum(keyed.size + OVERHEAD for keyed in due)
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
        self._size += keyed.size + OVERHEAD
        for held in window.take(keyed):
            self._size -= held.size + OVERHEAD
            yield valve, held.item
        if self._size > LARGEST_QUEUES:
            for name, other in self._windows.items():
                for held in other.split(full=True) if other.size else ():
                    self._size -= held.size + OVERHEAD
                    yield name, held.item

    def rest(self) -> Iterator[tuple[str, Item]]:
        """Yield what is still held, valve by valve."""
        for valve, window in self._windows.items():
            for held in window.rest():
                yield valve, held.item
