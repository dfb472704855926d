"""Dask cluster: the same tasks on the workers of a scheduler, on this host or on others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from itertools import islice
from typing import Any

from spool_core.errors import InputError, how_to_install

from .executor import TRIES, Done, Found, Item

#: Tasks for each worker that wait at the scheduler.
AHEAD = 2
#: s in which a scheduler has to answer.
PATIENCE = 10
#: Address that means a cluster of processes of this host, which ends with the run.
LOCAL = "local"


class DaskCluster:
    """Dask cluster at ``address`` (such as ``tcp://10.0.0.5:8786``), or ``local`` with so many ``workers``.

    Raises:
        InputError: Dask is not installed, or no scheduler answers.
    """

    def __init__(self, address: str, workers: int) -> None:
        try:
            dask: Any = import_module("distributed")  # an extra
        except ImportError:
            raise InputError(f"--dask: Dask is not installed: {how_to_install('distributed')}") from None
        self._dask = dask
        self._cluster: Any = None
        try:
            if address == LOCAL:
                self._cluster = dask.LocalCluster(
                    n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
                )
            self._client: Any = dask.Client(self._cluster or address, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(f"--dask {address}: no scheduler answers there: {error}") from None

    def run(self, work: Callable[[Item], Found], items: Iterable[Item]) -> Iterator[Done[Item, Found]]:
        """Yield what was done, as the protocol says; workers may come and go."""
        waiting = iter(items)
        running: dict[Any, Item] = {}

        def submit(item: Item) -> Any:
            future = self._client.submit(work, item, pure=False, retries=TRIES)
            running[future] = item
            return future

        first = [submit(item) for item in islice(waiting, AHEAD * max(1, len(self._client.nthreads())))]
        completed = self._dask.as_completed(first)
        for future in completed:
            item = running.pop(future)
            error = future.exception()
            if error is not None:
                yield Done(item, None, f"{type(error).__name__}: {error}")
            else:
                yield Done(item, future.result())
            for following in islice(waiting, 1):
                completed.add(submit(following))

    def close(self) -> None:
        """Leave the scheduler, and end a cluster of this host."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()
