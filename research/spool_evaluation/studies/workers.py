"""Parallel work on many items, in processes of their own, with progress and time left."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

from spool_core.system import end_with_parent, processors
from spool_tools.terminal import progress

Item = TypeVar("Item")
Result = TypeVar("Result")


def spread(
    work: Callable[[Item], Result], items: Sequence[Item], what: str, workers: int | None = None
) -> Iterator[Result]:
    """Yield ``work(item)`` for each item as it is done, in any order.

    Args:
        work: a function of a module, so that another process finds it.
        items: what it is called with.
        what: shown with the bar.
        workers: processes; as many as there are cores by default, 1 stays in this process.
    """
    count = min(workers or processors(), len(items))
    with progress(what, len(items)) as advance:
        if count <= 1:
            for item in items:
                yield work(item)
                advance(1.0)
            return
        # Forked processes would inherit the threads of numerical libraries in any state.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(count, mp_context=context, initializer=end_with_parent) as pool:
            futures = [pool.submit(work, item) for item in items]
            try:
                for future in as_completed(futures):
                    yield future.result()
                    advance(1.0)
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
