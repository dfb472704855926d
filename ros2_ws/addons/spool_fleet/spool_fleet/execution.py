"""Execution of the tasks of a fleet: what is to be done, in processes here or on a Dask cluster."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from spool_core.errors import InputError, how_to_install
from spool_core.faults import unexpected
from spool_core.system import end_with_parent, limit_processors
from spool_core.text import printable
from spool_core.uncertainty import as_json

from spool_fleet.manifest import Manifest, Outcome
from spool_fleet.parquet import bring_up_to_date

if TYPE_CHECKING:
    from spool_report.runs.record_replay import ReplaySettings


DONE, FAILED = "ok", "failed"
#: Characters of a reason.
LONGEST = 300

Item = TypeVar("Item")
Found = TypeVar("Found")

#: Times that work is begun whose worker died: one killed worker is an accident, three are the work's doing.
TRIES = 3

#: Tasks under way for each worker: one more than it works at, so that none stands still.
AHEAD = 2

#: s in which a scheduler has to answer.
PATIENCE = 10
#: Address that means a cluster of processes of this host, which ends with the run.
LOCAL = "local"


@dataclass(slots=True)
class RunResult:
    """What a run did: numbers of bags and of analyses, and a line about each that failed."""

    bags: int = 0
    analyses: int = 0
    failed: list[str] = field(default_factory=list)


def tasks_due(
    manifest: Manifest,
    keys: Mapping[str, str],
    settings: Callable[[str], ReplaySettings | None] = lambda _: None,
) -> list[Task]:
    """Return the tasks that a run has to do, in order of path.

    Args:
        manifest: the store's.
        keys: key of each analysis by its name; results of another key are computed again.
        settings: gives those of the monitor for a namespace, ``None`` for the shipped ones.
    """
    tasks = []
    for path, work in manifest.due(keys).items():
        valve_file = manifest.of(path)[0].valve_file or None
        parts = tuple((name, tuple(names)) for name, names in work.items())
        tasks.append(Task(path, parts, valve_file, {name: settings(name) for name in work}))
    return tasks


def run_tasks(
    manifest: Manifest,
    tasks: Sequence[Task],
    keys: Mapping[str, str],
    pool: ProcessPool,
    advance: Callable[[float], None] = lambda _: None,
) -> RunResult:
    """Run ``tasks``, keep each result as it comes, and bring the tables up to date.

    Args:
        manifest: the store's.
        tasks: as of ``tasks_due``.
        keys: of each analysis, kept with its results: what they follow from besides the record.
        pool: runs them.
        advance: called with the number of bags that were done.
    """
    result = RunResult()
    for done in pool.run(run_task, tasks):
        outcomes = done.found if done.found is not None else failed(done.item, done.reason)
        manifest.keep(done.item.path, keys, outcomes)
        result.bags += 1
        result.analyses += len(outcomes)
        result.failed += [
            f"{done.item.path}: {one.namespace}: {one.analysis}: {one.reason}"
            for one in outcomes
            if one.status != DONE
        ]
        advance(1)
    result.failed.sort()
    bring_up_to_date(manifest)
    return result


@dataclass(frozen=True, slots=True)
class Task:
    """Which analyses of which valves of the bag at ``path``; ``valve_file`` as in ``Subject``.

    ``settings`` holds those of each valve, by namespace.
    """

    path: str
    work: tuple[tuple[str, tuple[str, ...]], ...]
    valve_file: str | None = None
    settings: Mapping[str, ReplaySettings | None] = field(default_factory=dict)


def run_task(task: Task) -> list[Outcome]:
    """Return the outcomes of ``task``; an analysis that fails is one of them."""
    return [_run(task, namespace, name) for namespace, names in task.work for name in names]


def failed(task: Task, reason: str) -> list[Outcome]:
    """Return the outcomes of a task that could not be run."""
    return [
        Outcome(namespace, name, FAILED, printable(reason, LONGEST), {})
        for namespace, names in task.work
        for name in names
    ]


@dataclass(frozen=True, slots=True)
class Done(Generic[Item, Found]):
    """What was ``found`` for ``item``, or the ``reason`` why nothing could be."""

    item: Item
    found: Found | None
    reason: str = ""


class ProcessPool:
    """Process pool of ``workers`` processes, each of which uses one processor."""

    def __init__(self, workers: int) -> None:
        self.workers = workers

    def run(self, work: Callable[[Item], Found], items: Iterable[Item]) -> Iterator[Done[Item, Found]]:
        """Yield what was done as it becomes known, in no order; items are taken as workers become free.

        Who was at work when a worker died is not known: all that were under way are tried again, from the
        third time on each alone, so that only the work that ends its process is given up.
        """
        waiting = iter(items)
        again: list[tuple[Item, int]] = []
        pool = self._executor()
        running: dict[Future[Found], tuple[Item, int]] = {}
        try:
            while True:
                free = self.most() - len(running)
                following = [again.pop() for _ in range(min(free, len(again)))]
                following += [(item, 1) for item in islice(waiting, max(0, free - len(following)))]
                for item, tries in following:
                    running[pool.submit(work, item)] = item, tries
                if not running:
                    return
                broken = False
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    item, tries = running.pop(future)
                    try:
                        done = Done(item, future.result())
                    except BrokenProcessPool:
                        broken = True
                        again.append((item, tries + 1))
                        continue
                    except Exception as error:  # whatever the work raised
                        done = Done(item, None, f"{type(error).__name__}: {error}")
                    yield done
                if broken:
                    again += [(item, tries + 1) for item, tries in running.values()]
                    running.clear()
                    pool.shutdown(wait=False)
                    suspects = [item for item, tries in again if tries >= TRIES]
                    again = [(item, tries) for item, tries in again if tries < TRIES]
                    for item in suspects:
                        yield _alone(work, item)
                    pool = self._executor()
        finally:
            for future in running:
                future.cancel()
            pool.shutdown(wait=False)

    def close(self) -> None:
        """End what runs between two calls of ``run``: here nothing."""

    def _executor(self) -> Executor:
        return _pool(self.workers)

    def most(self) -> int:
        """Return how many items may be under way."""
        return AHEAD * self.workers


def prepare_worker() -> None:
    """Limit a worker to one processor, leave Ctrl-C to the driver, and end the worker with the driver."""
    limit_processors(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    gc.freeze()


class DaskCluster(ProcessPool):
    """Processes of a Dask cluster, which may come and go.

    ``address`` is that of the scheduler, such as ``tcp://10.0.0.5:8786``, or ``local`` for a cluster of so
    many ``workers`` on this host.

    Raises:
        InputError: Dask is not installed, or no scheduler answers.
    """

    def __init__(self, address: str, workers: int) -> None:
        try:
            dask: Any = import_module("distributed")  # an extra
        except ImportError:
            raise InputError(f"--dask: Dask is not installed: {how_to_install('distributed')}") from None
        super().__init__(workers)
        self._cluster: Any = None
        try:
            if address == LOCAL:
                self._cluster = dask.LocalCluster(
                    n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
                )
            self._client: Any = dask.Client(self._cluster or address, timeout=PATIENCE)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(f"--dask {address}: no scheduler responds at this address: {error}") from None

    def close(self) -> None:
        """Leave the scheduler, and end a cluster of this host."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def _executor(self) -> Executor:
        executor: Executor = self._client.get_executor(pure=False, retries=TRIES)
        return executor

    def most(self) -> int:
        """Return how many items may be under way; workers that come are used."""
        return AHEAD * max(1, len(self._client.nthreads()))


def _run(task: Task, namespace: str, name: str) -> Outcome:
    from spool_fleet.analyses import ANALYSES, Subject  # noqa: PLC0415 - slow to load

    subject = Subject(Path(task.path), namespace, task.valve_file, task.settings.get(namespace))
    try:
        rows = ANALYSES[name](subject)
    except InputError as error:
        return Outcome(namespace, name, FAILED, printable(error, LONGEST), {})
    except (OSError, MemoryError) as error:
        return Outcome(namespace, name, FAILED, printable(f"{type(error).__name__}: {error}", LONGEST), {})
    except Exception as error:  # one bag must not end a run over thousands; the reason is kept
        return Outcome(namespace, name, FAILED, printable(unexpected(error), LONGEST), {})
    return Outcome(namespace, name, DONE, "", as_json(rows))


def _alone(work: Callable[[Item], Found], item: Item) -> Done[Item, Found]:
    """Return what ``work`` finds in a separate process."""
    pool = _pool(1)
    try:
        return Done(item, pool.submit(work, item).result())
    except BrokenProcessPool:
        return Done(item, None, "its analysis crashed the worker process repeatedly")
    except Exception as error:  # whatever the work raised
        return Done(item, None, unexpected(error))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _pool(workers: int) -> ProcessPoolExecutor:
    # Arenas of glibc keep what threads freed: one is enough for a worker that uses one processor.
    os.environ.setdefault("MALLOC_ARENA_MAX", "1")
    # What a bag needed is given back after it: workers are to stay as small as after their first.
    os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", "131072")
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=prepare_worker)
