"""Cells of a CSV file: what kind each column holds, and its text as numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

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
HOLES = (
    "-", "--", "---", "#N/A", "#NV", "#N/V", "N/A", "n/a", "NA", "na", "NULL", "null", "None", "none",
    "NaN", "nan", "NAN", "#NUM!", "#VALUE!", "#DIV/0!", "#REF!", "*", "***", "?", "1.#QNAN",
    "-1.#IND", "1.#IND", "-nan", "-NaN",
)  # fmt: skip
_HOLES = frozenset(HOLES)
_CLOCK = r"\d{1,2}:\d{2}:\d{2}(?:[.,:]\d{1,9})?(?:\s*[AaPp]\.?[Mm]\.?)?"
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATES = (
    r"(?:\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}\.\d{1,2}\.(?:\d{4}|\d{2})"
    r"|\d{1,2}[/-]\d{1,2}[/-](?:\d{4}|\d{2})"
    rf"|\d{{1,2}}[- ](?:{'|'.join(_MONTHS)})[a-z]*\.?[- ]\d{{4}})"
)
_DAY_OR_MONTH = re.compile(r"(\d{1,2})[/-](\d{1,2})[/-](?:\d{4}|\d{2})(?!\d)")
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


def shape_of(cell: str, decimal: str) -> tuple[int, int] | None:
    """Return decimals and digits of the exponent of a number, ``None`` for other cells."""
    match = re.fullmatch(rf"[-+]?\d*(?:{re.escape(decimal)}(\d*))?(?:[eE][-+]?(\d*))?", cell)
    return (len(match[1] or ""), -1 if match[2] is None else len(match[2])) if match else None


def date_order(texts: Iterable[str]) -> str:
    """Return how dates like 05/04/2026 are written: ``dmy``, ``mdy``, "" where they could be two.

    A number above 12 is a day. ``both`` where no date says: there is none, or day and month are equal.
    """
    found = {match.groups() for text in texts if (match := _DAY_OR_MONTH.match(text.strip()))}
    first, second = any(int(one) > 12 for one, _ in found), any(int(two) > 12 for _, two in found)
    if first != second:
        return "dmy" if first else "mdy"
    return "both" if all(int(one) == int(two) for one, two in found) else ""


def moments(text: pa.ChunkedArray, order: str = "dmy") -> NDArray[np.int64]:
    """Return moments, or dates and clocks joined by a blank, as ns since 1970; UTC where no zone is named.

    Args:
        text: dates by ISO 8601 with any of `-/.`, day first with dots, with the month's English name, or with
            slashes in the ``order`` given; clocks of 24 hours, or of 12 with AM and PM.
        order: ``mdy``, or ``dmy`` and all else.

    Raises:
        pa.ArrowInvalid: a cell is none.
    """
    import pyarrow as pa  # noqa: PLC0415 - 26 MB that bags do not need
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    plain = call.utf8_trim_whitespace(text)
    for pattern, written in (
        *_DATES_AS_WRITTEN,
        _SLASHED.get(order, _SLASHED["dmy"]),
        *_TIMES_AS_WRITTEN,
    ):
        plain = call.replace_substring_regex(plain, pattern, written)
    afternoon = call.match_substring_regex(plain, r"(?i)p\.?m\.?$")
    twelve = call.match_substring_regex(plain, r"(?i)[ap]\.?m\.?$")
    plain = call.replace_substring_regex(plain, r"(?i)\s*[ap]\.?m\.?$", "")
    zone = r"\s*(Z|[+-]\d{2}:?\d{2})$"
    zoned = bool(call.any(call.match_substring_regex(plain, zone)).as_py())
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


def clocks(text: pa.ChunkedArray) -> NDArray[np.int64]:
    """Return times of day as ns since midnight; of the day after where midnight passes."""
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    parsed = moments(call.binary_join_element_wise("1970-01-01", call.utf8_trim_whitespace(text), " "))
    passed = np.concatenate([[0], np.cumsum(np.diff(parsed) < -_DAY_NS // 2)])
    return np.asarray(parsed + _DAY_NS * passed, dtype=np.int64)
