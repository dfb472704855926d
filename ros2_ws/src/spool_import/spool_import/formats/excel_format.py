"""Excel workbooks: each sheet with rows of numbers is a table, with the same headers as CSV files."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from datetime import date, datetime, time, timezone
from pathlib import Path
from typing import Any

import numpy as np
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.csv_text.dialect import header_of
from spool_import.tables.table import MOST_CHANNELS, STAMP, ArrayTable, Channel, Group, check_size, too_long

from .format import Format

#: Rows above the samples that are looked at.
PROBED = 200
#: Rows of a sheet by the file format (ECMA-376): 2^20.
MOST_ROWS = 1 << 20


def opened(path: Path) -> ArrayTable:
    """Return the sheets that hold rows of numbers.

    Raises:
        InputError: there is none, or a cell among the samples is no number.
    """
    import openpyxl  # noqa: PLC0415 - 0.1 s that nobody else needs

    with zipfile.ZipFile(path) as packed:
        check_size(path, sum(entry.file_size for entry in packed.infolist()))
    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    found = []
    for sheet in book.worksheets:
        rows = [tuple(row[:MOST_CHANNELS]) for row in sheet.iter_rows(values_only=True)]
        if len(rows) > MOST_ROWS:
            raise too_long(path)
        table = _table(path, sheet.title, rows)
        if table is not None:
            found.append((sheet.title, *table))
    book.close()
    if not found:
        raise InputError(f"{path}: no sheet with rows of numbers in it")
    single = len(found) == 1
    groups: list[Group] = []
    arrays: dict[tuple[str, str], Any] = {}
    for title, channels, columns in found:
        name = "" if single else title
        groups.append(Group(name, tuple(channels)))
        arrays |= {(name, channel.name): column for channel, column in zip(channels, columns, strict=True)}
    return ArrayTable(path, tuple(groups), arrays)


def _table(path: Path, title: str, rows: Sequence[tuple[Any, ...]]) -> tuple[list[Channel], list[Any]] | None:
    first = next((at for at, row in enumerate(rows[:PROBED]) if _is_data(row)), None)
    if first is None:
        return None
    width = max(at for at, cell in enumerate(rows[first]) if cell is not None) + 1
    above = [["" if cell is None else str(cell) for cell in row[:width]] for row in rows[:first]]
    _, names, units = header_of(above, width, width)
    body = [row[:width] for row in rows[first:]]
    while body and all(cell is None for cell in body[-1]):
        body.pop()
    channels, columns = [], []
    for at in range(width):
        cells = [row[at] if at < len(row) else None for row in body]
        known = next((cell for cell in cells if cell is not None), None)
        if known is None or isinstance(known, str):
            continue
        stamped = isinstance(known, (datetime, date, time))
        try:
            column = np.array([_number(cell) for cell in cells], dtype=np.int64 if stamped else np.float64)
        except (TypeError, ValueError, OverflowError):
            bad = next(row for row, cell in enumerate(cells) if not _is_number(cell))
            raise InputError(
                f"{path}: sheet {printable(title, 40)}, row {first + bad + 1}: {printable(names[at], 40)} is "
                f"{printable(cells[bad], 40)!r}, not a number"
            ) from None
        channels.append(Channel(names[at], STAMP if stamped else units[at], time=stamped))
        columns.append(column.astype("datetime64[ns]") if stamped else column)
    return (channels, columns) if channels else None


def _is_data(row: tuple[Any, ...]) -> bool:
    filled = [cell for cell in row if cell is not None]
    known = [cell for cell in filled if isinstance(cell, (int, float, datetime, time))]
    numeric = any(isinstance(cell, (int, float)) for cell in known)
    return numeric and len(known) >= 0.5 * len(filled)


def _is_number(cell: Any) -> bool:
    try:
        _number(cell)
    except (TypeError, ValueError):
        return False
    return True


def _number(cell: Any) -> float | int:
    """Return a cell as a number, a moment in ns since 1970; an empty one is NaN."""
    if cell is None:
        return float("nan")
    if isinstance(cell, datetime):
        return round(cell.replace(tzinfo=timezone.utc).timestamp() * 1e6) * 1000
    if isinstance(cell, time):
        return ((cell.hour * 60 + cell.minute) * 60 + cell.second) * 1_000_000_000 + cell.microsecond * 1000
    return float(cell)


FORMAT = Format("Excel", (".xlsx", ".xlsm"), opened)
