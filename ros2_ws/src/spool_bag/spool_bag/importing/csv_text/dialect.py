"""Dialect of a CSV file: preamble, header, unit row, delimiter, decimal mark and kinds of columns."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.tables.table import MOST_CHANNELS

from .cells import Kind, is_grouped, kind_of
from .layout import Layout, column_kinds, layout_of
from .pieces import LONGEST_LINE

#: Lines by which a dialect is known: the longest preambles of loggers have some hundred lines.
PROBED = 500
#: Characters of runs of blanks as one delimiter.
BLANKS = " "
_DELIMITERS = (";", "\t", ",", "|", BLANKS)
#: Share of a row's cells that are numbers or times: status words may stand beside them.
DATA_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Dialect:
    """Dialect of a CSV file.

    ``layout``: where the samples begin, names and units by column, and a rate stated above them. ``grouped``:
    there
    are marks between thousands. ``unproven``: columns of which a point or comma could be a mark between
    thousands or the decimal one, as far as the first lines show.
    """

    delimiter: str
    decimal: str
    layout: Layout
    kinds: tuple[Kind, ...]
    grouped: bool = False
    unproven: frozenset[str] = frozenset()

    @property
    def skipped(self) -> int:
        """Number of lines above the first row of samples."""
        return self.layout.first

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.layout.names

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was understood, for people."""
        mark = {"\t": "tab", BLANKS: "blank"}.get(self.delimiter, f"'{self.delimiter}'")
        said = [f"columns separated by {mark}, decimal {'comma' if self.decimal == ',' else 'point'}"]
        if self.grouped:
            said[0] += ", marks between thousands"
        above = self.skipped - (not self.layout.numbered)
        if above > 0:
            said.append(f"{above} lines above the samples besides the names")
        if self.layout.numbered:
            said.append("no header: columns are called 0, 1, 2 and so on")
        left = [name for name, kind in zip(self.names, self.kinds, strict=True) if kind is Kind.TEXT]
        if left:
            said.append(f"left out, since they hold text: {listed(left)}")
        return tuple(said)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, without quotes and blanks around them."""
    if delimiter == BLANKS:
        return line.split()
    row = next(csv.reader([line], delimiter=delimiter), [])
    return [cell.strip() for cell in row]


def dialect(path: Path, text: str) -> Dialect:
    """Return the dialect of a file by its first lines.

    Raises:
        InputError: no rows of numbers in it, or too many columns.
    """
    lines = text.split("\n")[:PROBED]
    if max(map(len, lines)) > LONGEST_LINE:
        raise InputError(f"{path}: its first lines are longer than {LONGEST_LINE >> 20} MB")
    if max(line.count(mark) for line in lines[:20] for mark in ",;\t") >= MOST_CHANNELS:
        raise InputError(
            f"{path}: a line has more than {MOST_CHANNELS} columns: one line each sample, one column "
            "each channel"
        )
    readings = [
        found
        for delimiter in _DELIMITERS
        for decimal in (".", ",")
        if delimiter != decimal and (found := _reading(lines, delimiter, decimal)) is not None
    ]
    if not readings and sum(bool(line.strip()) for line in lines) < 2:
        raise InputError(f"{path}: 0 samples are too few for a record")
    if not readings:
        raise InputError(
            f"{path}: no rows of numbers in its first {len(lines)} lines: one line each sample, one "
            "column each "
            "channel"
        )
    return max(readings, key=lambda found: found[0])[1]


def _reading(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[tuple[float, ...], Dialect] | None:
    """Return how well the lines read in this way, and the dialect that it is."""
    rows = [cells_of(line, delimiter) for line in lines]
    marks = [[kind_of(cell, decimal) for cell in row] for row in rows]
    data = [_is_data(row) for row in marks]
    widths = Counter(len(row) for row, numeric in zip(rows, data, strict=True) if numeric)
    if not widths:
        return None
    width = max(widths, key=lambda size: (widths[size], size))
    kinds = column_kinds(
        [row for row, numeric in zip(marks, data, strict=True) if numeric and len(row) == width], width
    )
    first = next(at for at in range(len(rows)) if data[at] and len(rows[at]) == width)
    above = next((row for row in reversed(rows[:first]) if any(row)), [])
    while kinds and kinds[-1] is Kind.EMPTY and not any(above[len(kinds) - 1 : len(kinds)]):
        kinds = kinds[:-1]  # a delimiter at the end of each line
    if not any(kind is Kind.NUMBER for kind in kinds):
        return None
    layout = layout_of(rows, marks, kinds, width)
    # A channel may begin late, as an oil temperature does.
    kinds = tuple(Kind.NUMBER if kind is Kind.EMPTY and not layout.numbered else kind for kind in kinds)
    every = sum(any(row) for row in rows)
    filled = [at for at in range(layout.first, len(rows)) if any(rows[at])]
    samples = [at for at in filled if len(rows[at]) == width]
    numeric = sum(mark not in (Kind.TEXT, Kind.EMPTY) for at in samples for mark in marks[at])
    columns = [[rows[at][place] for at in samples] for place in range(len(kinds))]
    grouped = any(
        is_grouped(cell, decimal)
        for column, kind in zip(columns, kinds, strict=True)
        for cell in column
        if kind is Kind.NUMBER
    )
    doubtful = frozenset(
        name
        for name, kind, column in zip(layout.names, kinds, columns, strict=True)
        if kind is Kind.NUMBER and not grouped and not is_proven(column, decimal)
    )
    score = (
        round(len(samples) / every, 2),
        round(numeric / max(1, sum(len(kinds) for _ in samples)), 2),
        float(not layout.numbered or layout.first == 0),
        float(not grouped or any(decimal in cell for column in columns for cell in column)),
        float(len(kinds)),
        float(decimal == "."),
    )
    return score, Dialect(delimiter, decimal, layout, kinds, grouped, doubtful)


def _is_data(marks: Sequence[Kind]) -> bool:
    kinds = [kind for kind in marks if kind is not Kind.EMPTY]
    known = sum(kind is not Kind.TEXT for kind in kinds)
    return Kind.NUMBER in kinds and known >= DATA_SHARE * len(kinds)


def is_proven(cells: Sequence[str], decimal: str) -> bool:
    """Return whether cells show that their decimal mark is one, and none between thousands."""
    for cell in cells:
        whole, mark, fraction = cell.lstrip("+-").partition(decimal)
        if mark and (len(fraction) != 3 or not fraction.isdigit() or whole.startswith("0") or not whole):
            return True
        if not mark and len(whole) > 3:
            return True
    return False


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return ``names`` for one line of text, shortened and with nothing that steers a terminal."""
    shown = [printable(name, 40) for name in names[:most]]
    return ", ".join(shown + ([f"and {len(names) - most} more"] if len(names) > most else []))
