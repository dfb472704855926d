"""Run of analyses over the catalogue: resumable at any point, the same tables whoever computes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from spool_fleet.catalogue.manifest import Manifest, StoredResult
from spool_fleet.tables.parquet import missing_months, write_month

from .executor import Executor
from .task import DONE, Outcome, Task, failed, run_task

if TYPE_CHECKING:  # slow to load
    from spool_tools.operations.record_replay import ReplaySettings


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
    for month in missing_months(manifest):
        manifest.forget(month)
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
    executor: Executor,
    advance: Callable[[float], None] = lambda _: None,
) -> RunResult:
    """Run ``tasks``, keep each result as it comes, and bring the tables up to date.

    Args:
        manifest: the store's.
        tasks: as of ``tasks_due``.
        keys: of each analysis, kept with its results: what they follow from besides the record.
        executor: runs them.
        advance: is told the number of bags that were done.
    """
    result = RunResult()
    for done in executor.run(run_task, tasks):
        outcomes = done.found if done.found is not None else failed(done.item, done.reason)
        manifest.keep(done.item.path, keys, _stored(outcomes))
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


def bring_up_to_date(manifest: Manifest) -> None:
    """Write the tables of every month that lacks something."""
    for month in manifest.outdated():
        write_month(manifest, month)


def _stored(outcomes: Sequence[Outcome]) -> Iterator[tuple[str, StoredResult]]:
    for one in outcomes:
        yield one.namespace, StoredResult(one.analysis, one.status, one.reason, one.rows)
