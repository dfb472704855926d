"""Parallel work on many items, in processes of their own, with progress; rows kept as they are done."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

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


class KeptRow(Protocol):
    """Row of a study that a file keeps."""

    def to_dict(self) -> dict[str, Any]:
        """Return what the file holds of it."""


Row = TypeVar("Row", bound=KeptRow)


def appended(path: Path, rows: Iterable[Row]) -> Iterator[Row]:
    """Append each of ``rows`` to ``path`` as a line of JSON, then yield it."""
    cut_off = path.exists() and not path.read_text().endswith("\n")
    with path.open("a") as file:
        file.write("\n" if cut_off else "")
        for row in rows:
            file.write(json.dumps(row.to_dict()) + "\n")
            file.flush()
            yield row


def kept_rows(path: Path, row_from: Callable[[dict[str, Any]], Row]) -> list[Row]:
    """Return the rows that ``path`` holds; lines that were cut off are left out."""
    rows = []
    for line in path.read_text().splitlines() if path.exists() else ():
        with suppress(json.JSONDecodeError):
            rows.append(row_from(json.loads(line)))
    return rows
