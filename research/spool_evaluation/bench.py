"""Benchmarks: run them and show the rows."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from rich.console import Console
from rich.table import Table
from spool_core.errors import InputError, how_to_install
from spool_report.outputs import check_output, write_json

from spool_evaluation.benchmarks import BENCHMARKS
from spool_evaluation.results.dearer import dearer, reference_line
from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.results.timing import Row

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
    seconds: float | None = None,
    valves: Sequence[int] | None = None,
    against: Path | None = None,
) -> int:
    """Run the benchmark ``what``, or all; show the rows and write them as JSON.

    Args:
        what: one of ``BENCHMARKS``.
        json: file to write.
        markdown: file for the page, as those of docs/results.
        seconds: how long each run of ``host`` and ``record`` takes, and ``valves`` of how many each is.
        seed: of the first record of ``gap``; its own where left out.
        cases: how many records of ``gap``; its own where left out.
        against: page of the same benchmark to compare costs with.

    Returns:
        How many rows cost more than on that page.

    Raises:
        InputError: there is no benchmark of that name, or its peer is missing.
    """
    if what is not None and what not in BENCHMARKS:
        raise InputError(f"bench {what}: there is no such benchmark; there are {', '.join(BENCHMARKS)}")
    options = (("seed", seed), ("cases", cases), ("seconds", seconds), ("valves", valves))
    given = {name: value for name, value in options if value is not None and value != []}
    for name in given:
        owners = [one for one, taken in BENCHMARKS.items() if name in taken]
        if what is not None and what not in owners:
            raise InputError(f"bench {what}: --{name} belongs to {' and '.join(owners)}")
    check_output(markdown, "--markdown")
    if against is not None and not against.is_file():
        raise InputError(f"--against {against}: no such file; docs/results holds the published pages")
    names = (what,) if what else tuple(BENCHMARKS)
    modules = [_load(name) for name in names]
    rows: list[Row] = []
    unit = _load("estimate").reference() if markdown or against else 0.0
    for name, module in zip(names, modules, strict=True):
        found = list(module.run(**{key: value for key, value in given.items() if key in BENCHMARKS[name]}))
        Console(width=max(140, Console().width)).print(table_of(found))
        rows += found
    if json is not None:
        write_json(json, rows)
    if markdown is not None:
        several = ((name, value if isinstance(value, Sequence) else [value]) for name, value in given.items())
        said = "".join(f" --{name} {value}" for name, values in several for value in values)
        command = f"./spool bench {what or ''}{said} --markdown FILE".replace("  ", " ")
        # The first line of a module says what it measures.
        title = str(modules[0].__doc__).partition("\n")[0].rstrip(".") if what else "Benchmarks"
        about = [] if what in ("host", "record") else [ABOUT]
        write_page(markdown, title, command, [*about, markdown_of(rows), reference_line(unit)])
    worse = dearer(against, [row.cells() for row in rows], unit) if against else []
    for line in worse:
        print(f"dearer: {line}")
    return len(worse)


def _load(name: str) -> ModuleType:
    """Return the module of a benchmark.

    Raises:
        InputError: its peer is not installed.
    """
    try:
        module = import_module(f"{__package__}.benchmarks.{name}")
        for peer in getattr(module, "LATE", ()):
            if find_spec(peer) is None:
                raise ModuleNotFoundError(name=peer)
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0].startswith("spool_"):
            raise
        fix = f"./spool sets it up, elsewhere: {how_to_install(str(error.name))}"
        raise InputError(f"bench {name}: {error.name} is not installed; {fix}") from None
    return module


def table_of(rows: Sequence[Row]) -> Table:
    """Return ``rows`` as a table, with the columns in which any row has something."""
    columns, cells = _cells(rows)
    table = Table(*columns, box=None, pad_edge=False)
    for row in cells:
        table.add_row(*row)
    return table


def markdown_of(rows: Sequence[Row]) -> str:
    """Return ``rows`` as the same table in Markdown."""
    return markdown_table(*_cells(rows))


def _cells(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Return the names of the columns and the rows as text."""
    found = [row.cells() for row in rows]
    columns = list(dict.fromkeys(name for one in found for name in one))
    columns = [name for name in columns if any(one.get(name) for one in found)]
    return columns, [[one.get(name, "") for name in columns] for one in found]
