"""What a benchmark's work costs now, against the page that was published last."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from spool_core.errors import InputError

#: What costs so many times as much as on the page is named.
DEARER = 1.3
#: Columns that name a row, and those that hold its cost, in the order in which they are looked for.
NAMES, COSTS = ("work", "peer", "valves", "in", "recorder"), ("ours", "cores")
_REFERENCE = re.compile(r"Reference of this run: a sample of compiled RLS took ([\d.e+-]+) s")


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
