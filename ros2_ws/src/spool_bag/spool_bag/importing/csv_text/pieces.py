"""CSV text, packed or not and in any usual encoding, in bounded pieces of whole lines of UTF-8."""

from __future__ import annotations

import codecs
import gzip
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

from spool_core.errors import InputError

from .encodings import encoding_of

#: B of a line and of unpacked text that are read: 30 million samples of 300 B.
LONGEST_LINE = 1 << 20
MOST_TEXT = 1 << 33
_PIECE = 1 << 21
#: B by which the encoding is known.
_PROBE = 1 << 16


@dataclass(frozen=True, slots=True)
class TextPiece:
    """Piece of a text: whole lines, as UTF-8, and the number of the first of them, from 1.

    ``note``: which encoding was assumed; ``damage``: what is wrong with the text's end.
    """

    content: bytes
    line: int
    note: str = ""
    damage: str = ""


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


def _split(path: Path, stream: BinaryIO) -> Iterator[TextPiece]:
    rest, line, size, note = b"", 1, 0, ""
    decoder: codecs.IncrementalDecoder | None = None
    while read := stream.read(_PIECE):
        if size == 0:
            encoding, note = encoding_of(path, read[:_PROBE])
            if encoding != "utf-8":
                decoder = codecs.getincrementaldecoder(encoding)("replace")
        size += len(read)
        if size > MOST_TEXT:
            raise InputError(
                f"{path}: more than {MOST_TEXT >> 30} GB of text: split it, or convert it to a bag"
            )
        if decoder is not None:
            read = decoder.decode(read).encode()
        kept, nul, padding = read.partition(b"\0")
        if nul:
            _check_padding(path, stream, padding, line + (rest + kept).count(b"\n"))
            read = kept
        lines, end, rest_of_read = read.rpartition(b"\n")
        if end:
            whole = rest + lines + end
            yield TextPiece(whole, line, note)
            line += whole.count(b"\n")
            rest = rest_of_read
        else:
            rest += read
        if len(rest) > LONGEST_LINE:
            raise InputError(
                f"{path}: line {line} is longer than {LONGEST_LINE >> 20} MB: is this a CSV file with one "
                "sample a line?"
            )
        if nul:
            yield TextPiece(
                rest, line, note, f"it ends in NUL bytes from line {line} on: was the logger switched off?"
            )
            return
    if rest:
        yield TextPiece(rest, line, note)


def _check_padding(path: Path, stream: BinaryIO, padding: bytes, line: int) -> None:
    """Check that a text's NUL bytes reach to its end, as where a logger's last lines were never written.

    Raises:
        InputError: text follows.
    """
    size = 0
    while padding:
        size += len(padding)
        if padding.strip(b"\0\r\n\x1a ") or size > MOST_TEXT:
            raise InputError(
                f"{path}: line {line} holds NUL bytes and text follows: the file is damaged: copy it again"
            )
        padding = stream.read(_PIECE)
