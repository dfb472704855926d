"""CSV in any dialect: preamble, unit row, encodings, decimal comma, moments as text."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing import csv_cells
from spool_bag.importing.csv_cells import NOT_DECIMAL, Kind, TextPiece
from spool_bag.importing.csv_layout import BLANKS, Dialect, cells_of, dialect, is_proven
from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import STAMP, Channel, Group, GrowingColumns, Table, Values

if TYPE_CHECKING:
    import pyarrow as pa

_TIMES = (Kind.MOMENT, Kind.CLOCK)
#: B of text by which a dialect is known.
_PROBE = 1 << 16
#: Lines below the samples, such as a footer with statistics.
MOST_FOOTER = 50


class CsvTable(Table):
    """CSV file; parsed piece by piece, so that only the columns asked for are kept.

    Raises:
        InputError: it holds no rows of numbers.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        probe, encoding = b"", ""
        for piece in csv_cells.pieces(path):
            probe += piece.content
            encoding = piece.note
            if len(probe) > _PROBE:
                break
        if not probe.strip():
            raise InputError(f"{path}: the file is empty")
        try:
            self.dialect = dialect(path, probe[: 4 * _PROBE].decode("utf-8", "replace"))
        except InputError as error:
            raise (error if str(path) in str(error) else InputError(f"{path}: {error}")) from error
        self.notes = (*((encoding,) if encoding else ()), *self.dialect.notes)
        self._dates = _dates(self.dialect)
        self._shown = ""
        self._unproven = set(self.dialect.unproven)
        self._whole: dict[str, str] = {}
        layout = self.dialect.layout
        self.settings = Settings(layout.settings)
        channels = [
            Channel(
                name,
                STAMP if kind in _TIMES else unit,
                time=kind in _TIMES,
                number=number,
                own="" if header == name else header,
                dated=kind is not Kind.CLOCK or self.dialect.names[number] in self._dates,
                scaling=self.settings.scaling(name, whole=name in self.dialect.whole),
            )
            for number, (name, header, unit, kind) in enumerate(
                zip(layout.names, layout.headers, layout.units, self.dialect.kinds, strict=True)
            )
            if kind in (Kind.NUMBER, *_TIMES)
        ]
        self.unread = {
            name: NOT_DECIMAL if name in self.dialect.hexadecimal else "text"
            for name, kind in zip(layout.names, self.dialect.kinds, strict=True)
            if kind is Kind.TEXT
        }
        self.groups = (Group.stated("", channels, self.settings, layout.stated),)

    def where(self, row: int) -> str:
        """Return the line of a row."""
        return f"line {row + self.dialect.layout.first + 1}"

    def read(self, _group: Group, names: Sequence[str], single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of columns by name."""
        for name in filter(self.dialect.hexadecimal.__contains__, names):
            self._warn(f"{printable(name, 40)} is read as decimal numbers, and may hold {NOT_DECIMAL}")
        columns = GrowingColumns(self.path, names, single)
        for piece, last in self._samples():
            table = self._parse(piece, names, last=last)
            if table is not None:
                columns.add({name: self._values(piece, name, table) for name in names})
        return columns.take()

    def _samples(self) -> Iterator[tuple[TextPiece, bool]]:
        """Yield the text below the header, and whether a piece is the last, with the file's end."""
        skip = self.dialect.layout.first
        held: TextPiece | None = None
        for piece in csv_cells.pieces(self.path):
            content, line = piece.content, piece.line
            if piece.damage:
                self._warn(piece.damage)
            while skip and content:
                _, end, content = content.partition(b"\n")
                skip -= 1
                line += 1
                if not end:
                    content = b""
            if not content.strip():
                continue
            if self.dialect.delimiter == BLANKS:
                content = b"\n".join(b" ".join(row.split()) for row in content.split(b"\n"))
            if held is not None and len(content) < _PROBE:
                held = TextPiece(held.content + content, held.line)
                continue
            if held is not None:
                yield held, False
            held = TextPiece(content, line)
        if held is not None:
            yield held, True

    def _parse(self, piece: TextPiece, names: Sequence[str], *, last: bool) -> pa.Table | None:
        """Return the table of a piece; lines at the file's end that are no samples cost a warning."""
        import pyarrow as pa  # noqa: PLC0415 - 26 MB that bags do not need

        found = self.dialect
        end = _cut_short(piece, found) if last else None
        for _ in range(2):
            if end is not None:
                lines = _lines(piece)
                at = end - piece.line
                kept = "".join(f"{one}\n" for one in lines[:at]).encode()
                left = [one.strip() for one in lines[at:] if one.strip()]
                shown = printable(left[0], 40)
                what = f"line {end}" if len(left) == 1 else f"{len(left)} lines from line {end} on"
                self._warn(f"left out at the file's end, since it holds no whole sample: {what}, {shown!r}")
                piece = TextPiece(kept, piece.line)
                if not kept.strip():
                    return None
            try:
                return self._table(piece, names)
            except pa.ArrowInvalid as error:
                bad = _first_bad_line(piece, found, names)
                if bad is None:
                    raise InputError(f"{self.path}: {printable(error, 200)}") from error
                if not last or end is not None or not _ends_with(piece, found, names, bad[0]):
                    raise InputError(f"{self.path}: {bad[1]}") from error
                end = bad[0]
        return None

    def _warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings = (*self.warnings, text)

    def _table(self, piece: TextPiece, names: Sequence[str]) -> pa.Table:
        import pyarrow as pa  # noqa: PLC0415
        import pyarrow.csv as pa_csv  # noqa: PLC0415

        found = self.dialect
        wanted = {*names, *(self._dates[name] for name in names if name in self._dates)}
        kinds = dict(zip(found.names, found.kinds, strict=True))
        plain = {
            name
            for name in wanted
            if kinds[name] is Kind.NUMBER and not (self.dialect.grouped or name in self._unproven)
        }
        width = len(cells_of(piece.content.partition(b"\n")[0].decode("utf-8", "replace"), found.delimiter))
        extra = [f"\0{at}" for at in range(width - len(found.names))]
        table = pa_csv.read_csv(
            pa.BufferReader(piece.content),
            read_options=pa_csv.ReadOptions(
                column_names=[*found.names, *extra], use_threads=False, block_size=len(piece.content) + 1
            ),
            parse_options=pa_csv.ParseOptions(delimiter=found.delimiter),
            memory_pool=pa.system_memory_pool(),  # Arrow's own keeps what it once had
            convert_options=pa_csv.ConvertOptions(
                column_types={name: pa.float64() if name in plain else pa.string() for name in wanted},
                include_columns=sorted(wanted),
                decimal_point=found.decimal,
                null_values=["", *csv_cells.HOLES],
            ),
        )
        for at, name in enumerate(table.column_names):
            if kinds[name] is Kind.NUMBER and name not in plain:
                table = table.set_column(at, name, self._checked(name, table.column(name)))
        return table

    def _checked(self, name: str, text: Any) -> Any:
        """Return a column's text as numbers, without marks between thousands where they are known as such.

        Raises:
            InputError: a point or comma could be either.
        """
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import compute  # noqa: PLC0415

        call: Any = compute
        decimal = self.dialect.decimal
        text = call.utf8_trim_whitespace(text)
        holes = call.is_in(text, value_set=pa.array(["", *csv_cells.HOLES]))
        text = call.if_else(holes, pa.scalar(None, pa.string()), text)
        if self.dialect.grouped:
            for mark in csv_cells.GROUP_MARKS[decimal]:
                text = call.replace_substring_regex(text, rf"(\d){re.escape(mark)}(\d{{3}})\b", r"\1\2")
                text = call.replace_substring_regex(text, rf"(\d){re.escape(mark)}(\d{{3}})\b", r"\1\2")
        else:
            cells = text.drop_null().unique().to_pylist()
            if is_proven(cells, decimal):
                self._unproven.discard(name)
            elif any(decimal in cell for cell in cells):
                example = printable(next(cell for cell in cells if decimal in cell), 20)
                whole = next((cell for cell in cells if decimal not in cell), None) or self._whole.get(name)
                if whole is not None:
                    raise InputError(
                        f"{self.path}: {printable(name, 40)} holds {example} and {printable(whole, 20)}: is "
                        f"the mark "
                        "one of thousands or of decimals? export it without marks between thousands"
                    )
            elif cells:
                self._whole[name] = cells[0]
        return call.replace_substring(text, decimal, ".").cast(pa.float64())

    def _values(self, piece: TextPiece, name: str, table: pa.Table) -> NDArray[Any]:
        kind = self.dialect.kinds[self.dialect.names.index(name)]
        if kind is Kind.NUMBER:
            return np.asarray(table.column(name).to_numpy(), dtype=np.float64)
        import pyarrow as pa  # noqa: PLC0415
        from pyarrow import compute  # noqa: PLC0415

        call: Any = compute
        try:
            if kind is Kind.MOMENT:
                self.zoned = self.zoned or csv_cells.zone_named(table.column(name))
                return csv_cells.moments(table.column(name), self._order(table.column(name)))
            if name in self._dates:
                dates = table.column(self._dates[name])
                text = call.binary_join_element_wise(dates, table.column(name), " ")
                self.zoned = self.zoned or csv_cells.zone_named(text)
                return csv_cells.moments(text, self._order(dates))
            return csv_cells.clocks(table.column(name))
        except pa.ArrowInvalid as error:
            raise InputError(
                f"{self.path}: below line {piece.line}: {printable(name, 40)} is no time: "
                f"{printable(error, 100)}"
            ) from error

    def _order(self, dates: pa.ChunkedArray) -> str:
        """Return the order of day and month, as the user states it or the dates show it.

        Raises:
            InputError: a date could be two.
        """
        from pyarrow import compute  # noqa: PLC0415

        call: Any = compute
        days = call.unique(call.utf8_slice_codeunits(call.utf8_trim_whitespace(dates), 0, 10)).to_pylist()
        order, sure = csv_cells.date_order(
            str(self.path), [printable(one, 20) for one in days if one], self.dates or self._shown
        )
        self._shown = order if sure else self._shown
        return order


def _dates(found: Dialect) -> dict[str, str]:
    """Return the date column by the clock column that stands beside it."""
    dates = [name for name, kind in zip(found.names, found.kinds, strict=True) if kind is Kind.DATE]
    times = [name for name, kind in zip(found.names, found.kinds, strict=True) if kind is Kind.CLOCK]
    return {times[0]: dates[0]} if len(dates) == len(times) == 1 else {}


def _lines(piece: TextPiece) -> list[str]:
    return piece.content.decode("utf-8", "replace").split("\n")


def _first_bad_line(piece: TextPiece, found: Dialect, wanted: Sequence[str]) -> tuple[int, str] | None:
    """Return where the first row stands that is no row of numbers, and why; called once parsing failed."""
    for number, line in enumerate(_lines(piece), start=piece.line):
        said = _badness(line, number, found, wanted) if line.strip() else None
        if said:
            return number, said
    return None


def _badness(line: str, number: int, found: Dialect, wanted: Sequence[str]) -> str | None:
    """Return what is wrong with a line, ``None`` for a sample."""
    cells = cells_of(line, found.delimiter)
    if len(cells) < len(found.names):
        return f"line {number} has {len(cells)} cells, the header has {len(found.names)}"
    for name, kind, cell in zip(found.names, found.kinds, cells, strict=False):
        if name in wanted and kind is Kind.NUMBER and cell and cell not in csv_cells.HOLES:
            try:
                float(cell.replace(found.decimal, "."))
            except ValueError:
                if not (found.grouped and csv_cells.is_grouped(cell, found.decimal)):
                    hint = f": {NOT_DECIMAL}" if csv_cells.may_be_hexadecimal([cell]) else ""
                    shown = printable(cell, 40)
                    return f"line {number}: {printable(name, 40)} is {shown!r}, not a number{hint}"
    if len(cells) > len(found.names) and any(cells[len(found.names) :]):
        return f"line {number} has {len(cells)} cells, the header has {len(found.names)}"
    return None


def _ends_with(piece: TextPiece, found: Dialect, wanted: Sequence[str], bad: int) -> bool:
    """Return whether nothing but a few lines that are no samples follows from line ``bad`` on."""
    rest = [
        (at, line) for at, line in enumerate(_lines(piece), start=piece.line) if at >= bad and line.strip()
    ]
    return len(rest) <= MOST_FOOTER and all(_badness(line, at, found, wanted) for at, line in rest)


def _cut_short(piece: TextPiece, found: Dialect) -> int | None:
    """Return the number of the file's last line where it stops within a number, as the lines above show."""
    if piece.content.endswith(b"\n"):
        return None
    *above, last = _lines(piece)
    cells = cells_of(last, found.delimiter)
    usual = [row for line in above[-200:] if len(row := cells_of(line, found.delimiter)) == len(cells)]
    if len(usual) < 3 or not cells:
        return None
    shapes = {csv_cells.shape_of(row[-1], found.decimal) for row in usual}
    return None if csv_cells.shape_of(cells[-1], found.decimal) in shapes else piece.line + len(above)


def _is_text(_path: Path, head: bytes) -> bool:
    """Return whether a file begins as a text with numbers in it, whatever its name is."""
    try:
        text = head.decode("utf-8") if len(head) < 4 else head[:-3].decode("utf-8")
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter in "\t\r\n\ufeff" for letter in text) and any(
        map(str.isdigit, text)
    )


_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".asc", ".csv.gz", ".txt.gz", ".tsv.gz", ".dat.gz")
FORMAT = Format("CSV", _SUFFIXES, CsvTable, place=90, recognises=_is_text)
