"""Span of time of a recording: from when to when it is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from spool_core.block import BlockRun

from .ordering import WINDOW, Item

#: ns by which times of reception may lie behind or ahead of the sensors' stamps: a part that begins or ends
#: so close to a span is read as well.
APART = 60_000_000_000
#: Beyond any stamp, ns.
ALWAYS = 1 << 62


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
