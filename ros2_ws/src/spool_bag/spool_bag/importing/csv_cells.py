"""Text of a logger: its encoding, read in pieces, and the numbers in its cells."""

from __future__ import annotations

import codecs
import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError

from spool_bag.importing.units import VOCABULARY

if TYPE_CHECKING:
    import pyarrow as pa


_NUMBER = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|Inf|INF)"),
    ",": re.compile(r"[-+]?(\d+,?\d*|,\d+)([eE][-+]?\d+)?|[-+]?(inf|Inf|INF)"),
}
#: Numbers with marks between thousands, by the decimal mark; what could be a decimal fraction is no such.
_GROUPED = {
    ".": re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+(\.\d+)?|[-+]?[1-9]\d{0,2}(['’\u00a0\u202f]\d{3})+(\.\d+)?"),
    ",": re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d+)?|[-+]?[1-9]\d{0,2}(['’\u00a0\u202f ]\d{3})+(,\d+)?"),
}
#: Marks between thousands, by the decimal mark.
GROUP_MARKS = {".": ",'’\u00a0\u202f", ",": ".'’\u00a0\u202f "}
#: What loggers write where there is no value.
HOLES: tuple[str, ...] = tuple(VOCABULARY["holes"])
_HOLES = frozenset(HOLES)
#: Counts as they are in a register of a converter, and why they are not read: their sign is not known.
HEXADECIMAL = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{3,}")
NOT_DECIMAL = "hexadecimal numbers of unknown sign: write them as decimal numbers"
_CLOCK = r"\d{1,2}:\d{2}:\d{2}(?:[.,:]\d{1,9})?(?:\s*[AaPp]\.?[Mm]\.?)?"
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATES = (
    r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}\.\d{1,2}\.(?:\d{4}|\d{2})"
    r"|\d{1,2}[/-]\d{1,2}[/-](?:\d{4}|\d{2})"
    rf"|\d{{1,2}}[- ](?:{'|'.join(_MONTHS)})[a-z]*\.?[- ]\d{{4}})"
)
_DAY_OR_MONTH = re.compile(r"(\d{1,2})[/-](\d{1,2})[/-](\d{4}|\d{2})(?!\d)")
#: Dates with points begin with the day (DIN 1355), unless loggers of that year are hardly in use any more.
_DOTTED = re.compile(r"(\d{2})\.\d{2}\.(\d{2})(?!\d)")
OLDEST = 12
_DAY_NS, _HOUR_NS = 86_400_000_000_000, 3_600_000_000_000


class Kind(Enum):
    """Kind of a column's cells."""

    NUMBER = "number"
    MOMENT = "moment"
    DATE = "date"
    CLOCK = "clock"
    TEXT = "text"
    EMPTY = "empty"


_TIMES = (
    (
        Kind.MOMENT,
        re.compile(rf"{_DATES}(?:T|,? +){_CLOCK}\s*(?:Z|UTC|[+-]\d{{2}}:?\d{{2}})?", re.IGNORECASE),
    ),
    (Kind.DATE, re.compile(_DATES, re.IGNORECASE)),
    (Kind.CLOCK, re.compile(_CLOCK)),
)

#: Dates as they are written, and as ISO 8601 has them, in the order in which they are replaced.
_DATES_AS_WRITTEN = (
    *(
        (rf"(?i)^(\d{{1,2}})[- ]{month}[a-z]*\.?[- ](\d{{4}})", rf"\2-{number:02d}-\1")
        for number, month in enumerate(_MONTHS, start=1)
    ),
    (r"^(\d{1,2})\.(\d{1,2})\.(\d{4}|\d{2})([T ,]|$)", r"\3-\2-\1\4"),
)
_SLASHED = {
    "dmy": (r"^(\d{1,2})[/-](\d{1,2})[/-](\d{4}|\d{2})([T ,]|$)", r"\3-\2-\1\4"),
    "mdy": (r"^(\d{1,2})[/-](\d{1,2})[/-](\d{4}|\d{2})([T ,]|$)", r"\3-\1-\2\4"),
    "ymd": (r"^(\d{2})[/-](\d{1,2})[/-](\d{2})([T ,]|$)", r"\1-\2-\3\4"),
}
_TIMES_AS_WRITTEN = (
    (r"^(\d{2}-\d{1,2}-\d{1,2}([T ,]|$))", r"20\1"),
    (r"^(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})", r"\1-\2-\3"),
    (r"^(\d{4})-(\d)-", r"\1-0\2-"),
    (r"^(\d{4}-\d{2})-(\d)([T ,]|$)", r"\1-0\2\3"),
    (r"(?:T|,? +)(\d{1,2}:)", r" \1"),
    (r" (\d):", r" 0\1:"),
    (r"(\d{2}:\d{2}:\d{2})[,:](\d)", r"\1.\2"),
    (r"(?i)\s*UTC$", "Z"),
)

#: B of a line and of unpacked text that are read: 30 million samples of 300 B.
LONGEST_LINE = 1 << 20
MOST_TEXT = 1 << 33
_PIECE = 1 << 21
#: B by which the encoding is known.
_PROBE = 1 << 16

#: Encodings of text that is not Unicode, and their usual names, most common first.
_SINGLE: dict[str, str] = VOCABULARY["encodings"]
#: Words and units that stand above the samples of loggers; one of them found decides for an encoding.
_WORDS = re.compile("|".join(VOCABULARY["above_samples"]), re.IGNORECASE)


def kind_of(cell: str, decimal: str) -> Kind:
    """Return the kind of one cell, its spaces and quotes taken off."""
    if not cell or cell in _HOLES:
        return Kind.EMPTY
    if _NUMBER[decimal].fullmatch(cell) or is_grouped(cell, decimal):
        return Kind.NUMBER
    return next((kind for kind, pattern in _TIMES if pattern.fullmatch(cell)), Kind.TEXT)


def is_grouped(cell: str, decimal: str) -> bool:
    """Return whether a cell is a number with marks between thousands, e.g. `1.025,5` with decimal comma."""
    return bool(_GROUPED[decimal].fullmatch(cell))


def may_be_hexadecimal(cells: Sequence[str]) -> bool:
    """Return whether a column's cells may be hexadecimal: digits of one length, letters or zeros first.

    Numbers that increase throughout are a time or a counter.
    """
    if not cells or not all(map(HEXADECIMAL.fullmatch, cells)):
        return False
    letters = any(not cell.isdecimal() for cell in cells)
    return len({len(cell) for cell in cells}) == 1 and (
        letters or (any(cell[0] == "0" for cell in cells) and list(cells) != sorted(cells))
    )


def shape_of(cell: str, decimal: str) -> tuple[int, int] | None:
    """Return decimals and digits of the exponent of a number, ``None`` for other cells."""
    match = re.fullmatch(rf"[-+]?\d*(?:{re.escape(decimal)}(\d*))?(?:[eE][-+]?(\d*))?", cell)
    return (len(match[1] or ""), -1 if match[2] is None else len(match[2])) if match else None


def date_order(label: str, days: Iterable[str], given: str) -> tuple[str, bool]:
    """Return the order of dates like 05/04/2026 or 26/05/04, and whether they show it.

    Orders are ``dmy``, ``mdy`` and, for years of two digits, ``ymd``.

    Args:
        label: of the file, for messages.
        days: the dates, other texts among them.
        given: as the user states it, "" where not.

    Raises:
        InputError: a date could be several.
    """
    days = [one.strip().partition(" ")[0] for one in days]
    found = _date_orders(days)
    short = [match.groups() for one in days if (match := _DOTTED.match(one.strip()))]
    if not given and any(int(first) > OLDEST > int(last) for first, last in short):
        raise InputError(
            f"{label}: the date {days[0]} could begin with the year: type --dates dmy, or --dates ymd"
        )
    if not given and len(set(found.values())) > 1:
        ways = ", or ".join(f"--dates {one}" for one in found)
        begins = " or the ".join({"d": "day", "m": "month", "y": "year"}[one[0]] for one in found)
        raise InputError(f"{label}: the date {days[0]} could begin with the {begins}: type {ways}")
    return given or next(iter(found), "dmy"), len(found) == 1


def _date_orders(texts: Iterable[str]) -> dict[str, frozenset[tuple[int, int, int]]]:
    """Return year, month and day of dates by the orders in which all exist; none where there is no date."""
    found = {match.groups() for text in texts if (match := _DAY_OR_MONTH.match(text.strip()))}
    orders = {}
    for order, places in (("dmy", (2, 1, 0)), ("mdy", (2, 0, 1)), ("ymd", (0, 1, 2))):
        if order == "ymd" and not all(len(one[0]) == len(one[2]) == 2 for one in found):
            continue
        days = frozenset(
            (int(one[places[0]]) % 100, int(one[places[1]]), int(one[places[2]])) for one in found
        )
        if found and all(1 <= month <= 12 and 1 <= day <= 31 for _, month, day in days):
            orders[order] = days
    return orders


def zone_named(text: pa.ChunkedArray) -> bool:
    """Return whether one of the moments names its zone."""
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    found = call.match_substring_regex(
        call.utf8_trim_whitespace(text), r"(?i):\d\S*\s*(Z|UTC|[+-]\d{2}:?\d{2})$"
    )
    return bool(call.any(found).as_py())


def moments(text: pa.ChunkedArray, order: str = "dmy") -> NDArray[np.int64]:
    """Return moments, or dates and clocks joined by a blank, as ns since 1970; UTC where no zone is named.

    Args:
        text: dates by ISO 8601 with any of `-/.`, day first with dots, with the month's English name, or with
            slashes in the ``order`` given; clocks of 24 hours, or of 12 with AM and PM.
        order: ``mdy``, ``ymd``, or ``dmy`` and all else.

    Raises:
        pa.ArrowInvalid: a cell is none.
    """
    import pyarrow as pa  # noqa: PLC0415 - 26 MB that bags do not need
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    plain = call.utf8_trim_whitespace(text)
    year_first = ((r"^(\d{2})\.(\d{1,2})\.(\d{2})([T ,]|$)", r"\1-\2-\3\4"),) if order == "ymd" else ()
    for pattern, written in (
        *year_first,
        *_DATES_AS_WRITTEN,
        _SLASHED.get(order, _SLASHED["dmy"]),
        *_TIMES_AS_WRITTEN,
    ):
        plain = call.replace_substring_regex(plain, pattern, written)
    afternoon = call.match_substring_regex(plain, r"(?i)p\.?m\.?$")
    twelve = call.match_substring_regex(plain, r"(?i)[ap]\.?m\.?$")
    plain = call.replace_substring_regex(plain, r"(?i)\s*[ap]\.?m\.?$", "")
    zoned = bool(call.any(call.match_substring_regex(plain, r"\s*(Z|[+-]\d{2}:?\d{2})$")).as_py())
    plain = call.replace_substring_regex(plain, r"\s+(Z|[+-]\d{2}:?\d{2})$", r"\1")
    kind = pa.timestamp("ns", "UTC") if zoned else pa.timestamp("ns")
    found = np.asarray(plain.cast(kind).cast(pa.int64()).to_numpy(), dtype=np.int64)
    if not call.any(twelve).as_py():
        return found
    late, short = (
        np.asarray(one.to_numpy(zero_copy_only=False), dtype=np.int64) for one in (afternoon, twelve)
    )
    noon = found % _DAY_NS // _HOUR_NS == 12  # 12 AM is midnight, 12 PM noon
    return np.asarray(found + 12 * _HOUR_NS * (late - noon * short), dtype=np.int64)


def clocks(text: pa.ChunkedArray) -> NDArray[np.int64]:
    """Return times of day as ns since midnight; of the day after where midnight passes."""
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    parsed = moments(call.binary_join_element_wise("1970-01-01", call.utf8_trim_whitespace(text), " "))
    passed = np.concatenate([[0], np.cumsum(np.diff(parsed) < -_DAY_NS // 2)])
    return np.asarray(parsed + _DAY_NS * passed, dtype=np.int64)


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
            yield from _split(path, cast("BinaryIO", gzip.GzipFile(fileobj=raw)) if packed else raw)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: the compressed file is cut off or damaged ({error}): copy it again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def encoding_of(path: Path, start: bytes) -> tuple[str, str]:
    """Return the encoding of a text by its first bytes, and a note where it is assumed, "" where it is sure.

    Raises:
        InputError: it is no text.
    """
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16", ""
    text = start.rstrip(b"\0")  # space that a logger had reserved
    even, odd = text[0::2].count(0), text[1::2].count(0)
    if odd > 0.3 * len(text) and not even:
        return "utf-16-le", ""
    if even > 0.3 * len(text) and not odd:
        return "utf-16-be", ""
    if b"\0" in text or len(re.findall(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f]", text)) > 0.01 * len(text):
        raise InputError(
            f"{path}: it is a binary file, not a CSV text, and of no format that is read: export the "
            "record as CSV"
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(text)
    except UnicodeDecodeError:
        found = _legacy(text)
        return found, f"text assumed to be {_SINGLE[found]}, since it is no UTF-8"
    return ("utf-8-sig" if text.startswith(codecs.BOM_UTF8) else "utf-8"), ""


def _split(path: Path, stream: BinaryIO) -> Iterator[TextPiece]:
    rest, line, size, note = b"", 1, 0, ""
    decoder: codecs.IncrementalDecoder | None = None
    lone: bool | None = None
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
        read = _plain(read)
        # Lines of some oscilloscopes end in a carriage return alone.
        lone = (b"\r" in read and b"\n" not in read) if lone is None else lone
        read = read.replace(b"\r", b"\n") if lone else read
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


def _plain(text: bytes) -> bytes:
    """Return UTF-8 text with the minus, the blanks and the exponents that numbers have elsewhere."""
    if b"\xe2\x88\x92" in text:  # U+2212
        text = text.replace(b"\xe2\x88\x92", b"-")
    if b"\xc2\xa0" in text or b"\xe2\x80\xaf" in text:  # no-break spaces, but for those between thousands
        text = re.sub(rb"(?<!\d)(?:\xc2\xa0|\xe2\x80\xaf)|(?:\xc2\xa0|\xe2\x80\xaf)(?!\d)", b" ", text)
    if b"D+" in text or b"D-" in text:  # of Fortran
        text = re.sub(rb"(?<=[\d.])D(?=[+-]\d{1,3}\b)", b"E", text)
    return text


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


def _legacy(text: bytes) -> str:
    """Return the encoding in which a text, no UTF-8, makes most sense."""
    lines = b"\n".join(line for line in text.split(b"\n")[:500] if re.search(rb"[\x80-\xff]", line))
    if not lines:  # beyond the lines by which it is known
        return "cp1252"
    scores: dict[str, int] = {}
    for encoding in _SINGLE:
        try:
            decoded = lines.decode(encoding)
        except UnicodeDecodeError:
            continue
        scores[encoding] = len(_WORDS.findall(decoded))
    best = max(scores, key=lambda name: scores[name], default="cp1252")
    return best if scores.get(best) else _guessed(lines)


def _guessed(lines: bytes) -> str:
    try:
        from charset_normalizer import from_bytes  # noqa: PLC0415 - 20 ms, for few files
    except ImportError:
        return "cp1252"
    found = from_bytes(lines, cp_isolation=["cp1252", "gb18030", "cp932", "cp1251"]).best()
    names = {codecs.lookup(name).name: name for name in _SINGLE}
    return names.get(codecs.lookup(found.encoding).name, "cp1252") if found is not None else "cp1252"
