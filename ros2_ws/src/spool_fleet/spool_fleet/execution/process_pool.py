"""Process pool of this host; a worker that is killed costs its task another try."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice

from spool_core.system import limit_processors

from .executor import TRIES, Done, Found, Item

#: Tasks for each worker that wait in its queue, so that none stands still.
AHEAD = 2


class ProcessPool:
    """Process pool of ``workers`` processes, each of which uses one processor."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, work: Callable[[Item], Found], items: Iterable[Item]) -> Iterator[Done[Item, Found]]:
        """Yield what was done, as the protocol says.

        Who was at work when a worker died is not known: all that were under way are tried again, from the
        third time on each alone, so that only the work that ends its process is given up.
        """
        waiting = iter(items)
        again: list[tuple[Item, int]] = []
        pool = _pool(self.workers)
        try:
            running: dict[Future[Found], tuple[Item, int]] = {}
            while True:
                while len(running) < self.workers * AHEAD and again:
                    item, tries = again.pop()
                    running[pool.submit(work, item)] = item, tries
                for item in islice(waiting, max(0, self.workers * AHEAD - len(running))):
                    running[pool.submit(work, item)] = item, 1
                if not running:
                    return
                broken = False
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    item, tries = running.pop(future)
                    error = future.exception()
                    if isinstance(error, BrokenProcessPool):
                        broken = True
                        again.append((item, tries + 1))
                    elif error is not None:
                        yield Done(item, None, f"{type(error).__name__}: {error}")
                    else:
                        yield Done(item, future.result())
                if broken:
                    again += [(item, tries + 1) for item, tries in running.values()]
                    running.clear()
                    pool.shutdown(wait=False, cancel_futures=True)
                    suspects = [item for item, tries in again if tries >= TRIES]
                    again = [(item, tries) for item, tries in again if tries < TRIES]
                    for item in suspects:
                        yield _alone(work, item)
                    pool = _pool(self.workers)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _alone(work: Callable[[Item], Found], item: Item) -> Done[Item, Found]:
    """Return what ``work`` finds in a process of its own."""
    pool = _pool(1)
    try:
        return Done(item, pool.submit(work, item).result())
    except BrokenProcessPool:
        return Done(item, None, "its analysis ended the worker process again and again")
    except Exception as error:  # whatever the work raised
        return Done(item, None, f"{type(error).__name__}: {error}")
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _pool(workers: int) -> ProcessPoolExecutor:
    # Arenas of glibc keep what threads freed: one is enough for a worker that uses one processor.
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")
    # What a bag needed is given back after it: workers are to stay as small as after their first.
    os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", "131072")
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=prepare_worker)


def prepare_worker() -> None:
    """Let a worker use one processor, leave Ctrl-C to the driver, and end with it."""
    limit_processors(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.freeze()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)
