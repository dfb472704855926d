"""Benchmarks: run them, show the rows, and compare their cost with the page that was published last."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from rich.console import Console
from rich.table import Table
from spool_core.errors import InputError, how_to_install
from spool_report.outputs import check_output, write_json

from spool_evaluation.benchmarks import BENCHMARKS
from spool_evaluation.results.page import markdown_table, write_page
from spool_evaluation.results.timing import Row

ABOUT = (
    'Their time over ours is "times as fast", both measured in one run; times of another run or machine '
    "differ by a factor of two. What is compared and what follows: [benchmarks](../methods/benchmarks.md)."
)

#: What costs so many times as much as on the page is named.
DEARER = 1.3
#: Columns that name a row, and those that hold its cost, in the order in which they are looked for.
NAMES, COSTS = ("work", "peer", "valves", "in", "recorder"), ("ours", "cores")
_REFERENCE = re.compile(r"Reference of this run: a sample of compiled RLS took ([\d.e+-]+) s")


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


def reference_line(seconds: float) -> str:
    """Return what a page says of the fixed work that was timed beside its rows."""
    return (
        f"Reference of this run: a sample of compiled RLS took {seconds:.3g} s. "
        "`./spool bench NAME --against PAGE` compares costs in units of it."
    )


def dearer(page: Path, rows: Sequence[Mapping[str, str]], reference: float) -> list[str]:
    """Return a line for each row that costs over ``DEARER`` times what the page says.

    Costs are in units of the reference work of the same run: another machine, or a busy one, changes both.

    Args:
        page: with the table of the same benchmark.
        rows: cells by column, of this run; rows that the page lacks are left out.
        reference: s a sample of the reference work in this run.

    Raises:
        InputError: the page cannot be compared with.
    """
    text = page.read_text(encoding="utf-8")
    then = _REFERENCE.search(text)
    if then is None:
        raise InputError(f"{page}: no reference of its run: make the page again with --markdown {page}")
    before = {_name(row): row for row in _table(text)}
    if before.keys().isdisjoint(map(_name, rows)):
        raise InputError(f"{page}: no row of this benchmark: name the page of the same one")
    found = []
    for row in rows:
        old = before.get(_name(row))
        if old is not None:
            factor = _cost(row) / reference / (_cost(old) / float(then[1]))
            if factor > DEARER:
                found.append(f"{', '.join(_name(row))}: {factor:.2g} times what it cost on {page.name}")
    return found


def _table(text: str) -> list[dict[str, str]]:
    lines = [
        [cell.strip() for cell in line.strip("|\n ").split(" | ")]
        for line in text.splitlines()
        if line[:1] == "|"
    ]
    return [dict(zip(lines[0], cells, strict=False)) for cells in lines[2:]]


def _name(row: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(row[name] for name in NAMES if row.get(name))


def _cost(row: Mapping[str, str]) -> float:
    return float(next(row[name] for name in COSTS if name in row).removesuffix(" s"))
