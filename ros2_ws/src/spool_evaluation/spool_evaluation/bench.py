"""Benchmarks: run them and show the rows."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from rich.console import Console
from rich.table import Table
from spool_stream.errors import InputError
from spool_tools.console.outputs import check_output, write_json

from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.results.timing import Timing

#: Each is a module of ``benchmarks`` with ``run() -> Iterator[Timing]``.
BENCHMARKS = ("sim", "bag", "estimate", "gap", "monitor", "nodes")
#: Those whose ``run`` takes ``seed`` and ``cases``: they judge records that are drawn.
DRAWN = ("gap", "monitor")
ABOUT = (
    'Their time over ours is "times as fast", both measured in one run; times of another run or machine '
    "differ by a factor of two. What is compared and what follows: [benchmarks](../methods/benchmarks.md)."
)


def run_bench(
    what: str | None,
    json: Path | None,
    seed: int | None = None,
    cases: int | None = None,
    markdown: Path | None = None,
) -> None:
    """Run the benchmark ``what``, or all; show the rows and write them as JSON.

    Args:
        what: one of ``BENCHMARKS``.
        json: file to write.
        markdown: file for the page, as those of docs/results.
        seed: of the first record of ``DRAWN``; their own where left out.
        cases: how many records of ``gap``, how often every kind of ``monitor``; their own where left out.

    Raises:
        InputError: there is no benchmark of that name, or its peer is missing.

    """
    if what is not None and what not in BENCHMARKS:
        raise InputError(f"bench {what}: there is no such benchmark; there are {', '.join(BENCHMARKS)}")
    given = {name: value for name, value in (("seed", seed), ("cases", cases)) if value is not None}
    if given and what is not None and what not in DRAWN:
        raise InputError(f"bench {what}: --{next(iter(given))} belongs to {' and '.join(DRAWN)}")
    check_output(markdown, "--markdown")
    names = (what,) if what else BENCHMARKS
    modules = [_load(name) for name in names]
    rows: list[Timing] = []
    for name, module in zip(names, modules, strict=True):
        rows += module.run(**(given if name in DRAWN else {}))
    Console(width=140).print(table_of(rows))
    if json is not None:
        write_json(json, [row.to_dict() for row in rows])
    if markdown is not None:
        options = "".join(f" --{name} {value}" for name, value in given.items())
        command = f"./spool bench {what or ''}{options} --markdown FILE".replace("  ", " ")
        # The first line of a module says what it measures.
        title = str(modules[0].__doc__).partition("\n")[0].rstrip(".") if what else "Benchmarks"
        write_page(markdown, title, command, [ABOUT, markdown_of(rows)])


def _load(name: str) -> ModuleType:
    """Return the module of a benchmark.

    Raises:
        InputError: its peer is not installed.
    """
    try:
        return import_module(f"{__package__}.benchmarks.{name}")
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0].startswith("spool_"):
            raise
        fix = f"./spool sets it up, elsewhere: pip install {error.name}"
        raise InputError(f"bench {name}: {error.name} is not installed; {fix}") from None


def table_of(rows: Sequence[Timing]) -> Table:
    """Return ``rows`` as a table, with the errors where any was measured."""
    columns, cells = _cells(rows)
    table = Table(*columns, box=None, pad_edge=False)
    for row in cells:
        table.add_row(*row)
    return table


def markdown_of(rows: Sequence[Timing]) -> str:
    """Return ``rows`` as the same table in Markdown."""
    columns, cells = _cells(rows)
    return markdown_table(columns, cells)


def _cells(rows: Sequence[Timing]) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns and the rows as text."""
    columns = ["work", "peer", "ours", "theirs", "times as fast"]
    parts = any(row.compiling is not None for row in rows)
    errors = any(row.ours_error is not None or row.peer_error is not None for row in rows)
    columns += ["by compiling", "by scheme"] if parts else []
    columns += ["our error", "their error"] if errors else []
    cells = []
    for row in rows:
        optional = [row.compiling, row.scheme] if parts else []
        optional += [row.ours_error, row.peer_error] if errors else []
        cells.append(
            [row.work, row.peer, f"{row.ours_s:.3g} s", f"{row.peer_s:.3g} s", f"{row.ratio:.3g}"]
            + ["" if one is None else f"{one:.3g}" for one in optional]
        )
    return columns, cells
