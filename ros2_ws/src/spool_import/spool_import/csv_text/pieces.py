"""CSV text, packed or not and in any usual encoding, in bounded pieces of whole lines of UTF-8."""

from __future__ import annotations

import codecs
import gzip
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from spool_stream.errors import InputError

#: B of a line and of unpacked text that are read: 30 million samples of 300 B.
LONGEST_LINE = 1 << 20
MOST_TEXT = 1 << 33
_PIECE = 1 << 21
#: B by which the encoding is known.
_PROBE = 1 << 16


@dataclass(frozen=True, slots=True)
class TextPiece:
    """Piece of a text: whole lines, as UTF-8, and the number of the first of them, from 1."""

    content: bytes
    line: int


def pieces(path: Path) -> Iterator[TextPiece]:
    """Yield the lines of a text file, plain or gzipped, in pieces of some MB.

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


def encoding_of(path: Path, start: bytes) -> str:
    """Return the encoding of a text by its first bytes: UTF-8, UTF-16, or else Windows' Latin-1.

    Raises:
        InputError: it is no text.
    """
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    even, odd = start[0::2].count(0), start[1::2].count(0)
    if odd > 0.3 * len(start) and not even:
        return "utf-16-le"
    if even > 0.3 * len(start) and not odd:
        return "utf-16-be"
    if b"\0" in start or len(re.findall(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]", start)) > 0.01 * len(start):
        raise InputError(
            f"{path}: it is a binary file, not a CSV text, and of no format that is read: export the "
            "record as CSV"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig" if start.startswith(codecs.BOM_UTF8) else "utf-8"


def _split(path: Path, stream: BinaryIO) -> Iterator[TextPiece]:
    rest, line, size = b"", 1, 0
    decoder: codecs.IncrementalDecoder | None = None
    while read := stream.read(_PIECE):
        if size == 0:
            encoding = encoding_of(path, read[:_PROBE])
            if encoding != "utf-8":
                decoder = codecs.getincrementaldecoder(encoding)("replace")
        size += len(read)
        if size > MOST_TEXT:
            raise InputError(
                f"{path}: more than {MOST_TEXT >> 30} GB of text: split it, or convert it to a bag"
            )
        if decoder is not None:
            read = decoder.decode(read).encode()
        lines, end, rest_of_read = read.rpartition(b"\n")
        if end:
            whole = rest + lines + end
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
