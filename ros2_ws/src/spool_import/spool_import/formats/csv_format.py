"""CSV in any dialect: preamble, unit row, encodings, decimal comma, moments as text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from spool_import.csv_text.cells import Kind, clocks, moments
from spool_import.csv_text.dialect import BLANKS, Dialect, cells_of, dialect
from spool_import.csv_text.pieces import TextPiece, pieces
from spool_import.tables.growing import GrowingColumns
from spool_import.tables.table import STAMP, Channel, Group, Table, Values

from .format import Format

if TYPE_CHECKING:
    import pyarrow as pa

_TIMES = (Kind.MOMENT, Kind.CLOCK)
#: B of text by which a dialect is known.
_PROBE = 1 << 16


class CsvTable(Table):
    """CSV file; parsed piece by piece, so that only what is asked for is kept.

    Raises:
        InputError: it holds no rows of numbers.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        probe = b""
        for piece in pieces(path):
            probe += piece.content
            if len(probe) > _PROBE:
                break
        if not probe.strip():
            raise InputError(f"{path}: the file is empty")
        self.dialect = dialect(path, probe[: 4 * _PROBE].decode("utf-8", "replace"))
        self.notes = self.dialect.notes
        self._dates = _dates(self.dialect)
        channels = [
            Channel(name, STAMP if kind in _TIMES else unit, time=kind in _TIMES)
            for name, unit, kind in zip(
                self.dialect.names, self.dialect.units, self.dialect.kinds, strict=True
            )
            if kind in (Kind.NUMBER, *_TIMES)
        ]
        self.groups = (Group("", tuple(channels)),)

    def where(self, row: int) -> str:
        """Return the line of a row."""
        return f"line {row + self.dialect.skipped + 1}"

    def read(self, _group: Group, names: Sequence[str], single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of columns by name."""
        found = self.dialect
        doubled = [name for name in names if found.names.count(name) > 1]
        if doubled:
            name = printable(doubled[0], 40)
            raise InputError(f"{self.path}: column {name} is there {found.names.count(doubled[0])} times")
        columns = GrowingColumns(self.path, names, single)
        for piece in self._samples():
            table = self._parse(piece, names)
            columns.add({name: self._values(piece, name, table) for name in names})
        return columns.take()

    def _samples(self) -> Iterator[TextPiece]:
        """Yield the text below the header."""
        skip = self.dialect.skipped
        for piece in pieces(self.path):
            content, line = piece.content, piece.line
            while skip and content:
                _, end, content = content.partition(b"\n")
                skip -= 1
                line += 1
                if not end:
                    content = b""
            if content.strip():
                if self.dialect.delimiter == BLANKS:
                    lines = (b" ".join(row.split()) for row in content.split(b"\n"))
                    content = b"\n".join(lines)
                yield TextPiece(content, line)

    def _parse(self, piece: TextPiece, names: Sequence[str]) -> pa.Table:
        import pyarrow as pa  # noqa: PLC0415 - 26 MB that bags do not need
        import pyarrow.csv as pa_csv  # noqa: PLC0415

        found = self.dialect
        wanted = {*names, *(self._dates[name] for name in names if name in self._dates)}
        kinds = dict(zip(found.names, found.kinds, strict=True))
        width = len(cells_of(piece.content.partition(b"\n")[0].decode("utf-8", "replace"), found.delimiter))
        extra = [f"\0{at}" for at in range(width - len(found.names))]
        try:
            return pa_csv.read_csv(
                pa.BufferReader(piece.content),
                read_options=pa_csv.ReadOptions(
                    column_names=[*found.names, *extra], use_threads=False, block_size=len(piece.content) + 1
                ),
                parse_options=pa_csv.ParseOptions(delimiter=found.delimiter),
                memory_pool=pa.system_memory_pool(),  # Arrow's own keeps what it once had
                convert_options=pa_csv.ConvertOptions(
                    column_types={
                        name: pa.float64() if kinds[name] is Kind.NUMBER else pa.string() for name in wanted
                    },
                    include_columns=sorted(wanted),
                    decimal_point=found.decimal,
                    null_values=["", "NaN", "nan", "NAN"],
                ),
            )
        except pa.ArrowInvalid as error:
            where = _first_bad_line(piece, found, names) or printable(error, 200)
            raise InputError(f"{self.path}: {where}") from error

    def _values(self, piece: TextPiece, name: str, table: pa.Table) -> NDArray[Any]:
        kind = self.dialect.kinds[self.dialect.names.index(name)]
        if kind is Kind.NUMBER:
            return np.asarray(table.column(name).to_numpy(), dtype=np.float64)
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import compute  # noqa: PLC0415

        call: Any = compute
        try:
            if kind is Kind.MOMENT:
                return moments(table.column(name))
            if name in self._dates:
                text = call.binary_join_element_wise(table.column(self._dates[name]), table.column(name), " ")
                return moments(text)
            return clocks(table.column(name))
        except pa.ArrowInvalid as error:
            raise InputError(
                f"{self.path}: below line {piece.line}: {printable(name, 40)} is no time: "
                f"{printable(error, 100)}"
            ) from error


def _dates(found: Dialect) -> dict[str, str]:
    """Return the date column by the clock column that stands beside it."""
    dates = [name for name, kind in zip(found.names, found.kinds, strict=True) if kind is Kind.DATE]
    times = [name for name, kind in zip(found.names, found.kinds, strict=True) if kind is Kind.CLOCK]
    return {times[0]: dates[0]} if len(dates) == len(times) == 1 else {}


def _first_bad_line(piece: TextPiece, found: Dialect, wanted: Sequence[str]) -> str | None:
    """Return where the first row stands that is no row of numbers; only called once parsing failed."""
    for number, line in enumerate(piece.content.decode("utf-8", "replace").split("\n"), start=piece.line):
        if not line.strip():
            continue
        cells = cells_of(line, found.delimiter)
        if len(cells) < len(found.names):
            return f"line {number} has {len(cells)} cells, the header has {len(found.names)}"
        for name, kind, cell in zip(found.names, found.kinds, cells, strict=False):
            if name in wanted and kind is Kind.NUMBER and cell:
                try:
                    float(cell.replace(found.decimal, "."))
                except ValueError:
                    return f"line {number}: {printable(name, 40)} is {printable(cell, 40)!r}, not a number"
        if len(cells) > len(found.names):
            return f"line {number} has {len(cells)} cells, the header has {len(found.names)}"
    return None


FORMAT = Format("CSV", (".csv", ".csv.gz", ".txt", ".tsv", ".dat", ".asc"), CsvTable, place=90)
