"""CSV text, packed or not, in bounded pieces of whole lines."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from spool_stream.errors import InputError
from spool_stream.text.printable import printable

#: B of a line, number of columns and B of unpacked text that are read: 12 million samples of 300 B.
LONGEST_LINE = 1 << 20
MOST_COLUMNS = 4096
MOST_TEXT = 1 << 32
MOST_LISTED = 12
_PIECE = 1 << 22


@dataclass(frozen=True, slots=True)
class Dialect:
    """Dialect of a CSV file: the names in its header and how it separates."""

    header: list[str]
    delimiter: str
    decimal: str


@dataclass(frozen=True, slots=True)
class TextPiece:
    """Piece of a text: whole lines and the number of the first of them, from 1."""

    content: bytes
    line: int


def pieces(path: Path) -> Iterator[TextPiece]:
    """Yield the lines of ``path`` (.csv, or gzipped) in pieces of some MB.

    Raises:
        InputError: unreadable, cut off, binary, or beyond the bounds.
    """
    try:
        with path.open("rb") as raw:
            packed = raw.read(2) == b"\x1f\x8b"
            raw.seek(0)
            yield from _split(path, cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: the compressed file is cut off or damaged ({error}): copy it again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def _split(path: Path, stream: BinaryIO) -> Iterator[TextPiece]:
    rest, line, size = b"", 1, 0
    while read := stream.read(_PIECE):
        if size == 0:
            _check_text(path, read[:4096])
        size += len(read)
        if size > MOST_TEXT:
            raise InputError(
                f"{path}: more than {MOST_TEXT >> 30} GB of text: split it, or convert it to a bag"
            )
        lines, end, rest_of_read = read.rpartition(b"\n")
        whole = rest + lines + end
        if end and (line > 1 or whole.count(b"\n") > 1):  # a header comes with the line below it
            yield TextPiece(whole, line)
            line += whole.count(b"\n")
            rest = rest_of_read
        else:
            rest += read
        if len(rest) > LONGEST_LINE:
            raise InputError(
                f"{path}: line {line} is longer than {LONGEST_LINE >> 20} MB: is this a CSV file with one "
                "sample a line?"
            )
    if rest:
        yield TextPiece(rest, line)


def _check_text(path: Path, start: bytes) -> None:
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise InputError(f"{path}: its text is UTF-16: save it as UTF-8")
    if b"\0" in start:
        raise InputError(f"{path}: it is a binary file, not a CSV text: export the record as CSV")


def dialect(path: Path, first: bytes, second: bytes) -> Dialect:
    """Return names and separators from a file's first two lines.

    Raises:
        InputError: too long, or too many columns.
    """
    if max(len(first), len(second)) > LONGEST_LINE:
        raise InputError(f"{path}: its first lines are longer than {LONGEST_LINE >> 20} MB")
    line = first.decode("utf-8-sig", "replace")
    delimiter = max(",;\t", key=line.count)
    if line.count(delimiter) >= MOST_COLUMNS:
        raise InputError(
            f"{path}: its header has {line.count(delimiter) + 1} columns, more than {MOST_COLUMNS}: "
            "one line each sample, one column each channel"
        )
    decimal = "," if delimiter != "," and b"," in second else "."
    return Dialect([cell.strip().strip('"').strip() for cell in line.split(delimiter)], delimiter, decimal)


def listed(names: Sequence[str]) -> str:
    """Return ``names`` for one line of text, shortened and with nothing that steers a terminal."""
    shown = [printable(name, 40) for name in names[:MOST_LISTED]]
    return ", ".join(shown + ([f"and {len(names) - MOST_LISTED} more"] if len(names) > MOST_LISTED else []))
