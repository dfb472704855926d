"""Excel workbooks: each sheet with rows of numbers is a table, with the same headers as CSV files."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.csv_cells import HOLES, Kind, clocks, date_order, kind_of, moments, zone_named
from spool_bag.importing.csv_layout import Layout, column_kinds, is_data, layout_of
from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import MOST_CHANNELS, STAMP, ArrayTable, Channel, Group, check_size, too_long

#: Rows above the samples that are looked at.
PROBED = 200
#: Rows of a sheet by the file format (ECMA-376): 2^20.
MOST_ROWS = 1 << 20
_TIMES = (Kind.MOMENT, Kind.CLOCK, Kind.DATE)
#: Formula in a sheet's XML.
_FORMULA = re.compile(rb"<f[ />]")


def opened(path: Path) -> ArrayTable:
    """Return the sheets that hold rows of numbers.

    Raises:
        InputError: there is none, or a cell among the samples is no number.
    """
    import openpyxl  # noqa: PLC0415 - 0.1 s that nobody else needs

    with zipfile.ZipFile(path) as packed:
        check_size(path, sum(entry.file_size for entry in packed.infolist()))
        sheets = [name for name in packed.namelist() if name.startswith("xl/worksheets/")]
        formulas = any(_FORMULA.search(packed.read(name)) for name in sheets)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
    found = []
    for sheet in book.worksheets:
        rows = [tuple(row[:MOST_CHANNELS]) for row in sheet.iter_rows(values_only=True)]
        if len(rows) > MOST_ROWS:
            raise too_long(path)
        if formulas and any(None in row for row in rows):
            rows = _with_formulas(path, sheet.title, rows)
        table = _table(path, sheet.title, rows)
        if table is not None:
            found.append((sheet.title, *table))
    book.close()
    if not found:
        raise InputError(f"{path}: no sheet with rows of numbers in it")
    single = len(found) == 1
    known = Settings(found[0][3].settings if single else None)
    groups: list[Group] = []
    arrays: dict[tuple[str, str], Any] = {}
    for title, channels, columns, layout in found:
        name = "" if single else title
        groups.append(Group.stated(name, channels, known, layout.stated))
        arrays |= {(name, channel.name): column for channel, column in zip(channels, columns, strict=True)}
    whole = ArrayTable(path, tuple(groups), arrays, settings=known)
    for column in arrays.values():
        if isinstance(column, _Column):
            column.table = whole
    return whole


def _table(
    path: Path, title: str, rows: Sequence[tuple[Any, ...]]
) -> tuple[list[Channel], list[Any], Layout] | None:
    """Return channels, their values and the layout of a sheet, ``None`` where it holds no rows of numbers."""
    probe = rows[:PROBED]
    data = [is_data([_kind(cell) for cell in row]) for row in probe]
    width = max(
        (
            at + 1
            for row, numeric in zip(probe, data, strict=True)
            if numeric
            for at, cell in enumerate(row)
            if cell is not None
        ),
        default=0,
    )
    if width == 0:
        return None
    cells_of_rows = [[row[at] if at < len(row) else None for at in range(width)] for row in probe]
    texts = [["" if cell is None else str(cell).strip() for cell in row] for row in cells_of_rows]
    marks = [[_kind(cell) for cell in row] for row in cells_of_rows]
    kinds = column_kinds([row for row, numeric in zip(marks, data, strict=True) if numeric], width)
    layout = layout_of(texts, marks, kinds, width)
    body = [row[:width] for row in rows[layout.first :]]
    while body and all(cell is None for cell in body[-1]):
        body.pop()
    channels: list[Channel] = []
    columns: list[Any] = []
    for at, kind in enumerate(kinds):
        cells = [row[at] if at < len(row) else None for row in body]
        if kind in (Kind.TEXT, Kind.EMPTY):
            continue
        stamped = kind in _TIMES
        name, header = layout.names[at], layout.headers[at]
        where = f"{path}: sheet {printable(title, 40)}, row %d: {printable(name, 40)}"
        column = _Column(cells, kind, layout.first + 1, where)
        unit = STAMP if stamped else layout.units[at]
        own = "" if name == header else header
        clock = stamped and (
            kind is Kind.CLOCK or all(isinstance(cell, time) for cell in cells if cell is not None)
        )
        elapsed = any(isinstance(cell, timedelta) for cell in cells)
        channels.append(
            Channel(name, "s" if elapsed else unit, time=stamped, number=at, own=own, dated=not clock)
        )
        columns.append(column if any(isinstance(cell, str) for cell in cells) else column.read())
    _date_clocks(channels, columns)
    return (channels, columns, layout) if channels else None


def _date_clocks(channels: list[Channel], columns: list[Any]) -> None:
    """Join a column of dates and one of times of day, which some loggers write apart."""
    day = np.timedelta64(86_400_000_000_000, "ns")
    clocks = [at for at, one in enumerate(channels) if one.time and not one.dated]
    dates = [
        at
        for at, one in enumerate(channels)
        if one.time
        and one.dated
        and isinstance(columns[at], np.ndarray)
        and not np.any((columns[at] - np.datetime64(0, "ns")) % day)
    ]
    if len(clocks) == len(dates) == 1 and isinstance(columns[clocks[0]], np.ndarray):
        (clock,), (date_at,) = clocks, dates
        columns[clock] = columns[clock] + (columns[date_at] - np.datetime64(0, "ns"))
        channels[clock] = replace(channels[clock], dated=True)
        del channels[date_at], columns[date_at]


def _kind(cell: Any) -> Kind:
    """Return the kind of a cell; text that is a number is one."""
    if cell is None:
        return Kind.EMPTY
    if isinstance(cell, bool):
        return Kind.TEXT
    if isinstance(cell, (int, float, timedelta, _Formula)):
        return Kind.NUMBER
    if isinstance(cell, (datetime, date, time)):
        return Kind.MOMENT
    kinds = [kind_of(str(cell).strip(), mark) for mark in ".,"]
    return Kind.NUMBER if Kind.NUMBER in kinds else kinds[0]


class _Formula(str):
    """Formula whose value is not in the workbook."""

    __slots__ = ()


def _with_formulas(path: Path, title: str, rows: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return rows with the formulas that no program has calculated in place of empty cells."""
    import openpyxl  # noqa: PLC0415

    book = openpyxl.load_workbook(path, read_only=True, keep_links=False)
    found = [
        tuple(
            _Formula(cell) if value is None and isinstance(cell, str) and cell.startswith("=") else value
            for value, cell in zip(values, cells, strict=False)
        )
        for values, cells in zip(rows, book[title].iter_rows(values_only=True), strict=False)
    ]
    book.close()
    return found


@dataclass(slots=True)
class _Column:
    """Column of a sheet, made numbers only when it is read: a word in another one refuses nothing.

    ``row``: number of its first row; ``where``: text with a place for a row's number. ``table``: whose order
    of dates holds.
    """

    cells: list[Any]
    kind: Kind
    row: int
    where: str
    table: ArrayTable | None = None

    def __array__(self, *_: object, **__: object) -> Any:
        return self.read()

    def read(self) -> Any:
        """Return the cells as numbers or, of times, as ns since 1970 or midnight.

        Raises:
            InputError: a cell is neither, with its place.
        """
        stamped = self.kind in _TIMES
        if stamped and all(isinstance(cell, str) for cell in self.cells):
            return self._of_text().astype("datetime64[ns]")
        column = np.empty(len(self.cells), dtype=np.int64 if stamped else np.float64)
        for at, cell in enumerate(self.cells):
            try:
                column[at] = _number(cell)
            except (TypeError, ValueError, OverflowError):
                shown = printable(cell, 40)
                why = f"{shown!r}, not a number"
                if isinstance(cell, _Formula):
                    why = f"the formula {shown} without a value: open the workbook in a spreadsheet, save it"
                raise InputError(f"{self.where % (self.row + at)} is {why}") from None
        return column.astype("datetime64[ns]") if stamped else column

    def _of_text(self) -> Any:
        import pyarrow as pa  # noqa: PLC0415 - 26 MB that most workbooks do not need

        text = pa.chunked_array([pa.array(self.cells, pa.string())])
        try:
            if self.kind is Kind.CLOCK:
                return clocks(text)
            given = self.table.dates if self.table is not None else ""
            days = {cell.strip()[:10] for cell in self.cells}
            if self.table is not None:
                self.table.zoned = self.table.zoned or zone_named(text)
            return moments(text, date_order(self.where.partition(": ")[0], days, given)[0])
        except pa.ArrowInvalid as error:
            raise InputError(f"{self.where % self.row} is no time: {printable(error, 100)}") from error


def _number(cell: Any) -> float | int:
    """Return a cell as a number, a moment in ns since 1970; a hole is NaN."""
    if cell is None:
        return float("nan")
    if isinstance(cell, datetime):
        return round(cell.replace(tzinfo=timezone.utc).timestamp() * 1e6) * 1000
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    if isinstance(cell, time):
        return ((cell.hour * 60 + cell.minute) * 60 + cell.second) * 1_000_000_000 + cell.microsecond * 1000
    if isinstance(cell, str):
        text = cell.strip()
        return float("nan") if text in HOLES or not text else float(text.replace(",", "."))
    return float(cell)


FORMAT = Format("Excel", (".xlsx", ".xlsm"), opened)
