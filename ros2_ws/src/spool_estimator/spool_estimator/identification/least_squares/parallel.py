"""Parallel work on all processors, in threads: kernels, transforms and large sums run without the lock."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from spool_core.system import processors

Item = TypeVar("Item")
Found = TypeVar("Found")


def in_parallel(work: Callable[[Item], Found], items: Iterable[Item]) -> list[Found]:
    """Return what ``work`` makes of each of ``items``, in their order."""
    every = list(items)
    threads = min(len(every), processors())
    if threads < 2:
        return [work(item) for item in every]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, every))
