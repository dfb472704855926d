"""Parallel work on many items, in separate processes, with progress; rows kept as they are done."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter
from spool_core.system import end_with_parent, processors
from spool_report.outputs import suite_version
from spool_report.terminal import progress

Item = TypeVar("Item", bound=Hashable)
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


def resumed(
    path: Path,
    kind: type[Result],
    item_of: Callable[[Result], Item],
    work: Callable[[Item], Result],
    items: Sequence[Item],
    what: str,
    workers: int | None = None,
) -> Iterator[Result]:
    """Yield a row for each of ``items``: those that ``path`` keeps, then the others as they are done.

    Each row is appended to ``path`` as a line of JSON as soon as it is done, so that a study that was stopped
    continues from its rows. Rows of another version of the suite are computed again, and so are all rows of
    sources that were changed since their commit.

    Args:
        path: file of rows.
        kind: dataclass of a row.
        item_of: returns the item that a row belongs to.
        work, items, what, workers: see :func:`spread`.
    """
    version, row_of = suite_version(), TypeAdapter(kind)
    kept, others, wanted = dict[Item, Result](), set[Item](), set(items)
    text = path.read_text("utf-8") if path.exists() else ""
    for line in text.splitlines():
        with suppress(ValueError, KeyError, TypeError):  # cut off, or of a version with other rows
            row = json.loads(line)
            one = row_of.validate_python(row["row"])
            if row["version"] != version or version.endswith("+)"):
                others.add(item_of(one))
            elif item_of(one) in wanted:
                kept[item_of(one)] = one
    if again := len(others & wanted - kept.keys()):
        print(f"{path}: {again} rows are of another version or of changed sources, and are computed again")
    yield from kept.values()
    missing = [item for item in items if item not in kept]
    with path.open("a", encoding="utf-8") as file:
        file.write("" if text.endswith("\n") or not text else "\n")
        for one in spread(work, missing, f"{len(missing)} {what}", workers):
            row = {"version": version, "row": row_of.dump_python(one)}
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield one
