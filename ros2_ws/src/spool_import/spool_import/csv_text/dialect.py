"""Dialect of a CSV file: preamble, header, unit row, delimiter, decimal mark and kinds of columns."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.tables.table import MOST_CHANNELS
from spool_import.units.header import split_header
from spool_import.units.units import quantity_of

from .cells import Kind, kind_of
from .pieces import LONGEST_LINE

#: Lines by which a dialect is known: the longest preambles of loggers have some hundred lines.
PROBED = 500
#: Characters of runs of blanks as one delimiter.
BLANKS = " "
_DELIMITERS = (";", "\t", ",", "|", BLANKS)
#: Share of a row's cells that are numbers or times: status words may stand beside them.
DATA_SHARE = 0.5
#: Cells that mark a header as a comment.
_COMMENTS = ("#", "%", "//")


@dataclass(frozen=True, slots=True)
class Dialect:
    """Dialect of a CSV file.

    ``skipped``: lines above the first row of samples. ``names`` and ``units`` by column; names are numbers
    from 0 where the file has no header. ``numbered``: it has none.
    """

    delimiter: str
    decimal: str
    skipped: int
    names: tuple[str, ...]
    units: tuple[str, ...]
    kinds: tuple[Kind, ...]
    numbered: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was understood, for people."""
        mark = {"\t": "tab", BLANKS: "blank"}.get(self.delimiter, f"'{self.delimiter}'")
        said = [f"columns separated by {mark}, decimal {'comma' if self.decimal == ',' else 'point'}"]
        above = self.skipped - (not self.numbered)
        if above > 0:
            said.append(f"{above} lines above the samples besides the names")
        if self.numbered:
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
    data = [_is_data(row, decimal) for row in rows]
    widths = Counter(len(row) for row, numeric in zip(rows, data, strict=True) if numeric)
    if not widths:
        return None
    width = max(widths, key=lambda size: (widths[size], size))
    first = next(at for at, row in enumerate(rows) if data[at] and len(row) == width)
    samples = [row for row in rows[first:] if len(row) == width]
    kinds = tuple(_column_kind([row[at] for row in samples], decimal) for at in range(width))
    above = next((row for row in reversed(rows[:first]) if any(row)), [])
    while kinds and kinds[-1] is Kind.EMPTY and not any(above[len(kinds) - 1 : len(kinds)]):
        kinds = kinds[:-1]  # a delimiter at the end of each line
    named, names, units = header_of(rows[:first], len(kinds), width)
    # A channel may begin late, as an oil temperature does.
    kinds = tuple(Kind.NUMBER if kind is Kind.EMPTY and named else kind for kind in kinds)
    filled = [row for row in rows[first:] if any(row)]
    numeric = sum(kind_of(cell, decimal) not in (Kind.TEXT, Kind.EMPTY) for row in samples for cell in row)
    score = (
        round(sum(len(row) == width for row in filled) / len(filled), 2),
        round(numeric / max(1, sum(len(kinds) for _ in samples)), 2),
        float(named or first == 0),
        float(len(kinds)),
        float(decimal == "."),
    )
    return score, Dialect(delimiter, decimal, first, names, units, kinds, not named)


def _is_data(row: Sequence[str], decimal: str) -> bool:
    kinds = [kind_of(cell, decimal) for cell in row if cell]
    known = sum(kind is not Kind.TEXT for kind in kinds)
    return bool(kinds) and Kind.NUMBER in kinds and known >= DATA_SHARE * len(kinds)


def _column_kind(cells: Sequence[str], decimal: str) -> Kind:
    counts = Counter(kind_of(cell, decimal) for cell in cells)
    counts.pop(Kind.EMPTY, None)
    return counts.most_common(1)[0][0] if counts else Kind.EMPTY


def header_of(
    above: Sequence[Sequence[str]], count: int, width: int
) -> tuple[bool, tuple[str, ...], tuple[str, ...]]:
    """Return whether there is a header above the samples, names and units."""
    rows = [row for row in above if any(row)][-2:]
    rows = [row[1:] if row[0] in _COMMENTS and len(row) == width + 1 else row for row in rows]
    fits = [list(row[:count]) for row in rows if count <= len(row) <= width]
    if not fits or len(rows[-1]) not in range(count, width + 1):
        return False, tuple(str(at) for at in range(count)), ("",) * count
    last = fits[-1]
    own_units = [quantity_of(cell) for cell in last]
    beneath = (
        len(fits) == 2
        and any(own_units)
        and all(known or not cell for known, cell in zip(own_units, last, strict=True))
    )
    if beneath:
        units = tuple(last)
        pairs = [split_header(cell) for cell in fits[0]]
        return (
            True,
            tuple(_plain(cell) for cell in fits[0]),
            tuple(unit or named for unit, (_, named) in zip(units, pairs, strict=True)),
        )
    last[0] = last[0].lstrip("#% ").strip() or last[0]
    pairs = [split_header(cell) for cell in last]
    return True, tuple(_plain(cell) for cell in last), tuple(unit for _, unit in pairs)


def _plain(cell: str) -> str:
    return cell.lstrip("\ufeff").lstrip("#% ").strip()


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return ``names`` for one line of text, shortened and with nothing that steers a terminal."""
    shown = [printable(name, 40) for name in names[:most]]
    return ", ".join(shown + ([f"and {len(names) - most} more"] if len(names) > most else []))
