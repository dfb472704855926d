"""Layout of a text table: separators, decimal sign, and the lines that are header."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.csv_cells import LONGEST_LINE, Kind, is_grouped, kind_of
from spool_bag.importing.table import MOST_CHANNELS, unique
from spool_bag.importing.units import NO_UNIT, WORDS, factor, is_unit, quantity_of, split_header

#: Cells that mark a line as a comment.
_COMMENTS = ("#", "%", "//")
#: First cells of a row of units.
_UNIT_WORDS = frozenset(
    {"unit", "units", "einheit", "einheiten", "vertical units", "y_unit_label", "单位", "単位"}
)
#: Rows above the samples among which names and units are looked for.
_NEAR = 6
#: Rows next to the samples one of which may hold units.
_UNITS_NEAR = 3
#: Rows of samples in succession from which on there is nothing but samples.
_RUN = 3
_TYPED = frozenset({Kind.NUMBER, Kind.MOMENT, Kind.DATE, Kind.CLOCK})
_SETTING = re.compile(
    r"[#%/\s\"]*(?P<key>[^=:;,\t]*[^\W\d][^=:;,\t]*?)\s*[=:;,\t\s]\s*(?P<value>[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
    r"\s*(?P<unit>[^\d\s;,]\S*)?[\s;,\"]*"
)
_RATE = re.compile(
    r"(?:actual |effective |nominal )?(?:sampl(?:e|es|ing)|scan|abtast|mess|acquisition|data|output "
    r"data|logging|采样)"
    r"[ _-]*(?:rate|freq(?:uency)?|frequenz|频率|率)|f_?s|odr|rate|sample/?s|samples per second"
)
_PERIOD = re.compile(
    r"(?:sampl(?:e|es|ing)|scan|abtast|mess)[ "
    r"_-]*(?:interval|intervall|period|periode|step|schritt|increment)|"
    r"x?[ _]?incr?(?:ement)?|delta[ _]?[xt]|d[xt]|t_?inc|time[ _]?(?:step|increment)|h(?:orizontal)?[ "
    r"_]interval"
)
_RATE_UNITS = {
    "": 1.0, "hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "sa/s": 1.0, "ks/s": 1e3, "ksa/s": 1e3,
    "ms/s": 1e6, "msa/s": 1e6, "sps": 1.0, "ksps": 1e3, "1/s": 1.0, "samples/s": 1.0, "samples/sec": 1.0,
}  # fmt: skip

#: Lines by which a dialect is known: the longest preambles of loggers have some hundred lines.
PROBED = 500
#: Characters of runs of blanks as one delimiter.
BLANKS = " "
_DELIMITERS = (";", "\t", ",", "|", BLANKS)
#: Share of a row's cells that are numbers or times: status words may stand beside them.
DATA_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of a table.

    ``first``: row of the first sample. ``names`` and ``units`` by column; names are numbers from 0 where
    there
    are none (``numbered``), ``headers`` are as the table has them. ``rate`` (Hz): of a setting above the
    samples,
    NaN without one, ``rate_from``: its name and row.
    """

    first: int
    names: tuple[str, ...]
    headers: tuple[str, ...]
    units: tuple[str, ...]
    numbered: bool
    rate: float
    rate_from: str


def layout_of(
    rows: Sequence[Sequence[str]], marks: Sequence[Sequence[Kind]], kinds: Sequence[Kind], width: int
) -> Layout:
    """Return the layout of a table by its first rows.

    Args:
        rows: their cells, without blanks around them.
        marks: the kind of each cell.
        kinds: of each column.
        width: cells of a row of samples, empty ones at its end included.

    Raises:
        InputError: settings above the samples contradict each other.
    """
    firm = _filled(marks, kinds)
    states = [_state(row, firm, width) for row in marks]
    first = _first_sample(rows, states)
    named = _header(rows, states, first, len(kinds), width)
    if named is None and _numeric_names(rows, states, kinds, first):
        names, units = [rows[first][at] for at in range(len(kinds))], [""] * len(kinds)
        above, first, numbered = first, first + 1, False
    elif named is None:
        names, units = [str(at) for at in range(len(kinds))], [""] * len(kinds)
        above, numbered = first, True
    else:
        names, units, above = named
        numbered = False
    rate, rate_from = _stated(rows, first, above)
    return Layout(first, unique(names), tuple(names), tuple(units), numbered, rate, rate_from)


def column_kinds(marks: Sequence[Sequence[Kind]], width: int) -> tuple[Kind, ...]:
    """Return the kind of each column by its cells, ``EMPTY`` where it has none."""
    kinds = []
    for at in range(width):
        counts = Counter(row[at] for row in marks if at < len(row))
        counts.pop(Kind.EMPTY, None)
        kinds.append(counts.most_common(1)[0][0] if counts else Kind.EMPTY)
    return tuple(kinds)


@dataclass(frozen=True, slots=True)
class Dialect:
    """Dialect of a CSV file.

    ``layout``: where the samples begin, names and units by column, and a rate stated above them. ``grouped``:
    there
    are marks between thousands. ``unproven``: columns of which a point or comma could be a mark between
    thousands or the decimal one, as far as the first lines show.
    """

    delimiter: str
    decimal: str
    layout: Layout
    kinds: tuple[Kind, ...]
    grouped: bool = False
    unproven: frozenset[str] = frozenset()

    @property
    def skipped(self) -> int:
        """Number of lines above the first row of samples."""
        return self.layout.first

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.layout.names

    @property
    def notes(self) -> tuple[str, ...]:
        """How the file was understood, for people."""
        mark = {"\t": "tab", BLANKS: "blank"}.get(self.delimiter, f"'{self.delimiter}'")
        said = [f"columns separated by {mark}, decimal {'comma' if self.decimal == ',' else 'point'}"]
        if self.grouped:
            said[0] += ", marks between thousands"
        above = self.skipped - (not self.layout.numbered)
        if above > 0:
            said.append(f"{above} lines above the samples besides the names")
        if self.layout.numbered:
            said.append("no header: columns are called 0, 1, 2 and so on")
        left = [name for name, kind in zip(self.names, self.kinds, strict=True) if kind is Kind.TEXT]
        if left:
            said.append(f"left out, since they hold text: {listed(left)}")
        return tuple(said)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line, without quotes and blanks around them."""
    if delimiter == BLANKS:
        return line.split()
    row = next(csv.reader([line], delimiter=delimiter), [])
    return [cell.strip() for cell in row]


def dialect(path: Path, text: str) -> Dialect:
    """Return the dialect of a file by its first lines.

    Raises:
        InputError: no rows of numbers in it, or too many columns.
    """
    lines = text.split("\n")[:PROBED]
    if max(map(len, lines)) > LONGEST_LINE:
        raise InputError(f"{path}: its first lines are longer than {LONGEST_LINE >> 20} MB")
    if max(line.count(mark) for line in lines[:20] for mark in ",;\t") >= MOST_CHANNELS:
        raise InputError(
            f"{path}: a line has more than {MOST_CHANNELS} columns: one line each sample, one column "
            "each channel"
        )
    readings = [
        found
        for delimiter in _DELIMITERS
        for decimal in (".", ",")
        if delimiter != decimal and (found := _reading(lines, delimiter, decimal)) is not None
    ]
    if not readings and sum(bool(line.strip()) for line in lines) < 2:
        raise InputError(f"{path}: 0 samples are too few for a record")
    if not readings:
        raise InputError(
            f"{path}: no rows of numbers in its first {len(lines)} lines: one line each sample, one "
            "column each "
            "channel"
        )
    return max(readings, key=lambda found: found[0])[1]


def is_proven(cells: Sequence[str], decimal: str) -> bool:
    """Return whether cells show that their decimal mark is one, and none between thousands."""
    for cell in cells:
        whole, mark, fraction = cell.lstrip("+-").partition(decimal)
        if mark and (len(fraction) != 3 or not fraction.isdigit() or whole.startswith("0") or not whole):
            return True
        if not mark and len(whole) > 3:
            return True
    return False


def listed(names: Sequence[str], most: int = 12) -> str:
    """Return ``names`` for one line of text, shortened and with nothing that steers a terminal."""
    shown = [printable(name, 40) for name in names[:most]]
    return ", ".join(shown + ([f"and {len(names) - most} more"] if len(names) > most else []))


class _Row(Enum):
    SAMPLES = "samples"  # each cell is what its column holds
    TEXT = "text"  # none is
    MIXED = "mixed"
    OTHER = "other"  # empty, or of another width


def _filled(marks: Sequence[Sequence[Kind]], kinds: Sequence[Kind]) -> list[Kind]:
    """Return the kinds of columns, ``TEXT`` for a mostly empty one: settings may stand beside samples."""
    rows = [row for row in marks if len(row) >= len(kinds)]
    return [
        kind if 2 * sum(row[at] is not Kind.EMPTY for row in rows) >= len(rows) else Kind.TEXT
        for at, kind in enumerate(kinds)
    ]


def _state(row: Sequence[Kind], kinds: Sequence[Kind], width: int) -> _Row:
    filled = [kind for kind in row if kind is not Kind.EMPTY]
    if not filled or len(row) < len(kinds):
        return _Row.OTHER
    typed = [
        (cell, kind)
        for cell, kind in zip(row, kinds, strict=False)
        if kind in _TYPED and cell is not Kind.EMPTY
    ]
    fitting = sum(cell is kind for cell, kind in typed)
    if fitting and fitting == len(typed) and len(row) <= width:
        return _Row.SAMPLES
    return _Row.MIXED if fitting else _Row.TEXT


def _first_sample(rows: Sequence[Sequence[str]], states: Sequence[_Row]) -> int:
    """Return the first sample: below the names, so that one with a bad cell is refused and not left out."""
    filled = [at for at, row in enumerate(rows) if any(row)]
    good = [at for at in filled if states[at] is _Row.SAMPLES]
    start = good[0] if good else 0
    for at, row in enumerate(filled):
        if all(states[one] is _Row.SAMPLES for one in filled[at : at + _RUN]):
            start = row
            break
    above = [at for at in filled if at < start]
    last_text = max(
        (at for at in above if states[at] is _Row.TEXT or _describes(rows[at], states[at])), default=-1
    )
    between = [
        at
        for at in above
        if at > last_text
        and (
            states[at] in (_Row.SAMPLES, _Row.MIXED)
            or (last_text >= 0 and len(rows[at]) > 1 and all(map(_is_number, rows[at])))
        )
    ]
    return between[0] if between else start


def _describes(row: Sequence[str], state: _Row) -> bool:
    """Return whether a row has a word in its first cell, as `Range;10;10` and `x-axis,1,2` have."""
    return (
        state is _Row.MIXED
        and bool(re.match(r"[\"#%/\s]*[^\W\d_]{2}|[^\W\d_]\b", row[0]))
        and row[0].lower() != "nan"
    )


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"[-+]?\d+[.,]?\d*(?:[eE][-+]?\d+)?", cell))


def _numeric_names(
    rows: Sequence[Sequence[str]], states: Sequence[_Row], kinds: Sequence[Kind], first: int
) -> bool:
    """Return whether the first row holds the numbers of channels: whole and different, above fractions."""
    row = rows[first][: len(kinds)]
    later = [rows[at] for at in range(first + 1, len(rows)) if states[at] is _Row.SAMPLES]
    if (
        len(later) < _RUN
        or len(set(row)) < len(row)
        or not all(re.fullmatch(r"\d{1,4}", cell) for cell in row)
    ):
        return False
    fractions = [bool(re.search(r"[.,eE]", cell)) for one in later for cell in one[: len(kinds)] if cell]
    return sum(fractions) > 0.99 * len(fractions)


def _header(
    rows: Sequence[Sequence[str]], states: Sequence[_Row], first: int, count: int, width: int
) -> tuple[list[str], list[str], int] | None:
    """Return names, units and the row of the first of both; ``None`` where there are none."""
    near = [at for at in range(first) if any(rows[at])][-_NEAR:]
    fitting: list[tuple[int, list[str]]] = []
    for at in reversed(near):
        row = [cell.lstrip("\ufeff") for cell in rows[at]]
        row = row[1:] if row[0] in _COMMENTS and len(row) == width + 1 else row
        row = [row[0].lstrip("#% ").strip() or row[0], *row[1:]]
        increments = any(re.match(r"(?:start|increment|t0\s*=|tinc\s*=)", cell.lower()) for cell in row)
        if count <= len(row) and (len(row) <= width or increments):
            if states[at] is _Row.TEXT or states[at] is _Row.OTHER or _describes(row, _Row.MIXED):
                fitting.append((at, row[:count]))
        elif fitting or len([cell for cell in row if cell]) > 1:
            break
    if not fitting:
        return None
    known = {at: sum(_is_known(cell) for cell in row) for at, row in fitting}
    for place, (at, row) in enumerate(fitting[:_UNITS_NEAR]):
        if not _are_units(row) or (place and row[0].casefold() in _UNIT_WORDS):
            continue
        others = [other for other in fitting[: _UNITS_NEAR + 1] if not _are_units(other[1])]
        others.sort(key=lambda other: (-known[other[0]], other[0] > at, abs(other[0] - at)))
        if others:
            above, names = others[0]
            pairs = [split_header(name) for name in names]
            units = [unit or pair[1] for unit, pair in zip(_units(row), pairs, strict=True)]
            return names, units, min(at, above)
        filled = [cell for cell in row if cell]
        if len(set(filled)) < len(filled):
            return [str(one) for one in range(count)], _units(row), at
    at, names = max(fitting, key=lambda one: (known[one[0]], one[0]))
    units = [split_header(name)[1] for name in names]
    return names, _scope_units(rows[:at], units), at


def _is_known(cell: str) -> bool:
    name, unit = split_header(cell)
    words = re.split(r"[\W_]+", name.lower())
    return bool(unit) or any(word in known for word in words for known in WORDS.values())


def _are_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: one that is known, and else nothing that could be a name."""
    cells = [_bare(cell) for cell in row]
    if cells and cells[0].casefold() in _UNIT_WORDS:
        cells[0] = ""
    cells = ["" if _is_number(cell) else cell for cell in cells]
    known = [cell for cell in cells if quantity_of(cell)]
    names = {word for words in WORDS.values() for word in words if not is_unit(word)}
    return (
        bool(known)
        and all(
            is_unit(cell) or cell.casefold() in NO_UNIT or (len(cell) <= 12 and cell.casefold() not in names)
            for cell in cells
            if cell
        )
        and 2 * len(known) >= len([cell for cell in cells if cell and cell.casefold() not in NO_UNIT])
    )


def _units(row: Sequence[str]) -> list[str]:
    cells = [_bare(cell) for cell in row]
    return ["" if cell.casefold() in NO_UNIT or cell.casefold() in _UNIT_WORDS else cell for cell in cells]


def _bare(cell: str) -> str:
    return cell.strip().strip("[](){}").strip() if cell.strip()[:1] in ("[", "(", "{") else cell.strip()


def _scope_units(above: Sequence[Sequence[str]], units: list[str]) -> list[str]:
    """Return units that oscilloscopes write as settings: `Horizontal Units,s` and `Vertical Units,V,V`."""
    rows = {row[0].strip().casefold(): [cell for cell in row[1:] if cell] for row in above if row and row[0]}
    vertical, horizontal = rows.get("vertical units", []), rows.get("horizontal units", [])
    if vertical and len(vertical) <= len(units) and is_unit(vertical[0]) and not any(units[1:]):
        units = [units[0] or (horizontal[0] if horizontal else ""), *vertical]
        units += [""] * (len(vertical) + 1 - len(units))
    return units


def _stated(rows: Sequence[Sequence[str]], first: int, above: int) -> tuple[float, str]:
    """Return the rate (Hz) that a setting above the samples states, NaN without one, and where it stands.

    Raises:
        InputError: two of them contradict each other.
    """
    found: list[tuple[float, str]] = []
    for at, row in enumerate(rows[:first]):
        below = rows[at + 1] if at + 1 < first else []
        for place, cell in enumerate(row):
            increment = re.fullmatch(r"t_?inc\s*=\s*(\S+)", cell.strip(), re.IGNORECASE)
            number = increment[1] if increment else ""
            if cell.strip().casefold() == "increment" and place < len(below):
                number = below[place]
            rate = _rate("increment", number.rstrip("sS"), "")
            found += [(rate, f"'{cell.strip()}', line {at + 1}")] if math.isfinite(rate) else []
        cells = [cell.strip().strip('"') for cell in row if cell.strip()]
        if at < above or len(cells) <= 2:
            found += _of_line(cells, at)
    for rate, where in found[1:]:
        if abs(rate / found[0][0] - 1.0) > 1e-3:
            raise InputError(
                f"{where} says {rate:g} Hz and {found[0][1]} says {found[0][0]:g} Hz: correct one of them"
            )
    return found[0] if found else (math.nan, "")


def _of_line(cells: Sequence[str], at: int) -> list[tuple[float, str]]:
    """Return the rate that a line of key and value states, with where."""
    if not cells or len(cells) > 4:
        return []
    match = (
        _SETTING.fullmatch(f"{cells[0]}\t{cells[1]}{' ' + cells[2] if len(cells) == 3 else ''}")
        if len(cells) > 1
        else None
    )
    match = match or _SETTING.fullmatch(cells[0])
    if not match:
        return []
    key, unit = split_header(match["key"].strip(" =:"))
    rate = _rate(key, match["value"], unit or match["unit"] or "")
    return [(rate, f"'{key}', line {at + 1}")] if math.isfinite(rate) else []


def _rate(key: str, value: str, unit: str) -> float:
    """Return the rate (Hz) of a setting, NaN where it is none."""
    plain = key.strip().lower()
    try:
        number = float(value.replace(",", "."))
    except ValueError:
        return math.nan
    if number <= 0.0:
        return math.nan
    if _RATE.fullmatch(plain) and unit.lower() in _RATE_UNITS:
        return number * _RATE_UNITS[unit.lower()]
    if _PERIOD.fullmatch(plain) and (not unit or quantity_of(unit) == "time"):
        return 1.0 / (number * (factor(unit, "time") if unit else 1.0))
    return math.nan


def _reading(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[tuple[float, ...], Dialect] | None:
    """Return how well the lines read in this way, and the dialect that it is."""
    rows = [cells_of(line, delimiter) for line in lines]
    marks = [[kind_of(cell, decimal) for cell in row] for row in rows]
    data = [is_data(row) for row in marks]
    widths = Counter(len(row) for row, numeric in zip(rows, data, strict=True) if numeric)
    if not widths:
        return None
    width = max(widths, key=lambda size: (widths[size], size))
    kinds = column_kinds(
        [row for row, numeric in zip(marks, data, strict=True) if numeric and len(row) == width], width
    )
    first = next(at for at in range(len(rows)) if data[at] and len(rows[at]) == width)
    above = next((row for row in reversed(rows[:first]) if any(row)), [])
    while kinds and kinds[-1] is Kind.EMPTY and not any(above[len(kinds) - 1 : len(kinds)]):
        kinds = kinds[:-1]  # a delimiter at the end of each line
    if not any(kind is Kind.NUMBER for kind in kinds):
        return None
    layout = layout_of(rows, marks, kinds, width)
    # A channel may begin late, as an oil temperature does.
    kinds = tuple(Kind.NUMBER if kind is Kind.EMPTY and not layout.numbered else kind for kind in kinds)
    every = sum(any(row) for row in rows)
    filled = [at for at in range(layout.first, len(rows)) if any(rows[at])]
    samples = [at for at in filled if len(rows[at]) == width]
    numeric = sum(mark not in (Kind.TEXT, Kind.EMPTY) for at in samples for mark in marks[at])
    columns = [[rows[at][place] for at in samples] for place in range(len(kinds))]
    grouped = any(
        is_grouped(cell, decimal)
        for column, kind in zip(columns, kinds, strict=True)
        for cell in column
        if kind is Kind.NUMBER
    )
    doubtful = frozenset(
        name
        for name, kind, column in zip(layout.names, kinds, columns, strict=True)
        if kind is Kind.NUMBER and not grouped and not is_proven(column, decimal)
    )
    score = (
        round(len(samples) / every, 2),
        round(numeric / max(1, sum(len(kinds) for _ in samples)), 2),
        float(not layout.numbered or layout.first == 0),
        float(not grouped or any(decimal in cell for column in columns for cell in column)),
        float(len(kinds)),
        float(decimal == "."),
    )
    return score, Dialect(delimiter, decimal, layout, kinds, grouped, doubtful)


def is_data(marks: Sequence[Kind]) -> bool:
    """Return whether a row is one of samples: numbers in it, and little text."""
    kinds = [kind for kind in marks if kind is not Kind.EMPTY]
    known = sum(kind is not Kind.TEXT for kind in kinds)
    return Kind.NUMBER in kinds and known >= DATA_SHARE * len(kinds)
