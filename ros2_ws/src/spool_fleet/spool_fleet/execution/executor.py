"""Executor of work on bags: what a process pool and a cluster have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

Item = TypeVar("Item")
Found = TypeVar("Found")

#: Times that work is begun whose worker died: one killed worker is an accident, three are the work's doing.
TRIES = 3


@dataclass(frozen=True, slots=True)
class Done(Generic[Item, Found]):
    """Done work: what was ``found`` for ``item``, or the ``reason`` why nothing could be."""

    item: Item
    found: Found | None
    reason: str = ""


class Executor(Protocol):
    """Executor: runs a function of one item, an item at a time on each worker, in no particular order."""

    def run(self, work: Callable[[Item], Found], items: Iterable[Item]) -> Iterator[Done[Item, Found]]:
        """Yield what was done as it becomes known; items are taken as workers become free."""
        ...
