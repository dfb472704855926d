"""Cells of a CSV file: what kind each column holds, and its text as numbers."""

from __future__ import annotations

import re
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
_CLOCK = r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d{1,9})?"
_DATES = r"(?:\d{4}-\d{2}-\d{2}|\d{4}/\d{2}/\d{2}|\d{1,2}\.\d{1,2}\.\d{4})"


class Kind(Enum):
    """Kind of a column's cells."""

    NUMBER = "number"
    MOMENT = "moment"
    DATE = "date"
    CLOCK = "clock"
    TEXT = "text"
    EMPTY = "empty"


_TIMES = (
    (Kind.MOMENT, re.compile(rf"{_DATES}[T ]{_CLOCK}\s*(?:Z|[+-]\d{{2}}:?\d{{2}})?")),
    (Kind.DATE, re.compile(_DATES)),
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


def moments(text: pa.ChunkedArray) -> NDArray[np.int64]:
    """Return moments, or dates and clocks joined by a blank, as ns since 1970; UTC where no zone is named.

    Raises:
        pa.ArrowInvalid: a cell is none.
    """
    import pyarrow as pa  # noqa: PLC0415 - 26 MB that bags do not need
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    plain = call.utf8_trim_whitespace(text)
    plain = call.replace_substring_regex(plain, r"^(\d{4})/(\d{2})/(\d{2})", r"\1-\2-\3")
    plain = call.replace_substring_regex(plain, r"^(\d)\.(\d{1,2}\.\d{4})", r"0\1.\2")
    plain = call.replace_substring_regex(plain, r"^(\d{2})\.(\d)\.(\d{4})", r"\1.0\2.\3")
    plain = call.replace_substring_regex(plain, r"^(\d{2})\.(\d{2})\.(\d{4})", r"\3-\2-\1")
    plain = call.replace_substring_regex(plain, r"[T ](\d):", r" 0\1:")
    plain = call.replace_substring_regex(plain, ",", ".")
    zone = r"\s*(Z|[+-]\d{2}:?\d{2})$"
    zoned = bool(call.any(call.match_substring_regex(plain, zone)).as_py())
    plain = call.replace_substring_regex(plain, r"\s+(Z|[+-]\d{2}:?\d{2})$", r"\1")
    kind = pa.timestamp("ns", "UTC") if zoned else pa.timestamp("ns")
    return np.asarray(plain.cast(kind).cast(pa.int64()).to_numpy(), dtype=np.int64)


def clocks(text: pa.ChunkedArray) -> NDArray[np.int64]:
    """Return times of day as ns since midnight; of the day after where midnight passes."""
    from pyarrow import compute  # noqa: PLC0415

    call: Any = compute
    day = 86_400_000_000_000
    parsed = moments(call.binary_join_element_wise("1970-01-01", call.utf8_trim_whitespace(text), " "))
    passed = np.concatenate([[0], np.cumsum(np.diff(parsed) < -day // 2)])
    return np.asarray(parsed + day * passed, dtype=np.int64)
