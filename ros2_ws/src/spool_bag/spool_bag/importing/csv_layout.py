"""Layout of a text table: separators, decimal sign, and the lines that are header."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from pathlib import Path

from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.csv_cells import (
    LONGEST_LINE,
    NOT_DECIMAL,
    Kind,
    is_grouped,
    kind_of,
    may_be_hexadecimal,
)
from spool_bag.importing.settings import StatedRate, key_and_text, stated_above
from spool_bag.importing.table import MOST_CHANNELS, unique
from spool_bag.importing.units import NO_UNIT, VOCABULARY, WORDS, is_unit, quantity_of, split_header

#: Cells that mark a line as a comment.
_COMMENTS = ("#", "%", "//")
#: First cells of a row of units.
_UNIT_WORDS = frozenset(VOCABULARY["unit_rows"])
#: Rows above the samples among which names and units are looked for.
_NEAR = 6
#: Rows next to the samples one of which may hold units.
_UNITS_NEAR = 3
#: Rows of samples in succession from which on there is nothing but samples.
_RUN = 3
#: Rows at the top of a table without names that may be no samples, and how far beyond the samples they are.
_ABOVE, _BEYOND = 3, 20.0
_TYPED = frozenset({Kind.NUMBER, Kind.MOMENT, Kind.DATE, Kind.CLOCK})
#: First cells of a row of numbers about the samples.
_STATISTICS = re.compile(
    r"(?:min|max|mean|avg|average|std|rms|peak|range|offset|scale|gain|median|mittel|mittelwert)[a-z]*\.?",
    re.IGNORECASE,
)

#: Lines that the cells of one row of names may take.
MOST_BREAKS = 24
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
    there are none (``numbered``), ``headers`` are as the table has them. ``stated``: rate by a setting above
    the samples. ``settings``: what else stands there, by key.
    """

    first: int
    names: tuple[str, ...]
    headers: tuple[str, ...]
    units: tuple[str, ...]
    numbered: bool
    stated: StatedRate
    settings: Mapping[str, str] = field(default_factory=dict)


def layout_of(
    rows: Sequence[Sequence[str]],
    marks: Sequence[Sequence[Kind]],
    kinds: Sequence[Kind],
    width: int,
    decimal: str = ".",
) -> Layout:
    """Return the layout of a table by its first rows.

    Args:
        rows: their cells, without blanks around them.
        marks: the kind of each cell.
        kinds: of each column.
        width: cells of a row of samples, empty ones at its end included.
        decimal: mark of the samples.

    Raises:
        InputError: settings above the samples contradict each other.
    """
    firm = _filled(marks, kinds)
    states = [_state(row, firm, width) for row in marks]
    first = _first_sample(rows, states)
    named = _keyed(rows[:first], len(kinds)) or _header(rows, states, marks, first, len(kinds), width)
    if named is None and _numeric_names(rows, states, kinds, first):
        names, units = [rows[first][at] for at in range(len(kinds))], [""] * len(kinds)
        heads, first, numbered = frozenset({first}), first + 1, False
    elif named is None:
        names, units = [str(at) for at in range(len(kinds))], [""] * len(kinds)
        first += _numbers_above(rows[first:], decimal)
        heads, numbered = frozenset({first}), True
    else:
        names, units, heads = named
        numbered = False
    stated, used = stated_above(rows, first, min(heads), decimal)
    settings = dict(
        key_and_text(row, at)
        for at, row in enumerate(rows[:first])
        if any(row) and at not in heads and at not in used
    )
    return Layout(first, unique(names), tuple(names), tuple(units), numbered, stated, settings)


def column_kinds(marks: Sequence[Sequence[Kind]], width: int) -> tuple[Kind, ...]:
    """Return the kind of each column by its cells, ``EMPTY`` where it has none."""
    kinds = []
    for at in range(width):
        counts = Counter(row[at] for row in marks if at < len(row) and row[at] is not Kind.EMPTY)
        kinds.append(counts.most_common(1)[0][0] if counts else Kind.EMPTY)
    return tuple(kinds)


@dataclass(frozen=True, slots=True)
class Dialect:
    """Dialect of a CSV file.

    ``layout``: where the samples begin, names and units by column, and a rate stated above them. ``grouped``:
    there
    are marks between thousands. ``unproven``: columns of which a point or comma could be a mark between
    thousands or the decimal one, as far as the first lines show. ``hexadecimal``: columns whose first cells
    may be that.
    """

    delimiter: str
    decimal: str
    layout: Layout
    kinds: tuple[Kind, ...]
    grouped: bool = False
    unproven: frozenset[str] = frozenset()
    hexadecimal: frozenset[str] = frozenset()
    whole: frozenset[str] = frozenset()

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
        above = self.layout.first - (not self.layout.numbered)
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
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def dialect(path: Path, text: str) -> Dialect:
    """Return the dialect of a file by its first lines.

    Raises:
        InputError: no rows of numbers in it, or too many columns.
    """
    lines = _joined(text.split("\n")[:PROBED])
    if max(map(len, lines)) > LONGEST_LINE:
        raise InputError(f"{path}: its first lines are longer than {LONGEST_LINE >> 20} MB")
    if max(line.count(mark) for line in lines[:20] for mark in ",;\t") >= MOST_CHANNELS:
        raise InputError(
            f"{path}: a line has more than {MOST_CHANNELS} columns: one line each sample, one column "
            "each channel"
        )
    quoted = any(re.search(r'"[-+]?\d+,\d+"', line) for line in lines)
    readings = [
        found
        for delimiter in _DELIMITERS
        for decimal in (".", ",")
        if (delimiter != decimal or quoted) and (found := _reading(lines, delimiter, decimal)) is not None
    ]
    if not readings and sum(bool(line.strip()) for line in lines) < 2:
        raise InputError(f"{path}: 0 samples are too few for a record")
    if not readings:
        hint = f"; it holds {NOT_DECIMAL}" if re.search(r"\b0[xX][0-9A-Fa-f]", text) else ""
        raise InputError(
            f"{path}: no rows of numbers in its first {len(lines)} lines: one line each sample, one "
            f"column each channel{hint}"
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


def _joined(lines: Sequence[str]) -> list[str]:
    """Return lines of which those that a line break within quotes divides are one; empty ones follow it."""
    joined: list[str] = []
    at = 0
    while at < len(lines):
        whole = next(
            (
                end
                for end in range(at + 1, min(at + MOST_BREAKS, len(lines)) + 1)
                if "".join(lines[at:end]).count('"') % 2 == 0
            ),
            at + 1,
        )
        if not re.search(r'(?:^|[,;\t|])"[^"]*$', lines[at]):  # no cell is open at its end
            whole = at + 1
        joined += [" ".join(lines[at:whole]), *[""] * (whole - at - 1)]
        at = whole
    return joined


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


def _numbers_above(rows: Sequence[Sequence[str]], decimal: str) -> int:
    """Return how many rows of numbers at the top of a table without names are no samples.

    They are one number in all columns, such as a rate, or far beyond all that follows, such as a date.
    """
    try:
        held = [[float(cell.replace(decimal, ".")) for cell in row if cell] for row in rows[:50]]
    except ValueError:
        return 0
    held = [row for row in held if row and len(row) == len(held[-1])]
    for at, row in enumerate(held[:_ABOVE]):
        later = held[at + 1 :]
        if len(row) < 2 or len(later) < _RUN:
            return at
        equal = sum(len(set(one)) == 1 for one in later)
        alike = len(set(row)) == 1 and row[0] != 0.0 and 10 * equal < len(later)
        most = [max(abs(one[place]) for one in later) for place in range(len(row))]
        if not alike and not all(
            abs(cell) > _BEYOND * top > 0.0 for cell, top in zip(row, most, strict=True)
        ):
            return at
    return 0


def _is_about(row: Sequence[str]) -> bool:
    """Return whether a row holds numbers about the samples, such as `Max;8.1;3.2`, no names or units."""
    cells = [cell for cell in row[1:] if cell]
    return (
        bool(cells)
        and all(map(_is_number, cells))
        and bool(
            _STATISTICS.fullmatch(row[0].strip(" :#%")) or any(re.search(r"[-.,eE]", cell) for cell in cells)
        )
    )


def _header(
    rows: Sequence[Sequence[str]],
    states: Sequence[_Row],
    marks: Sequence[Sequence[Kind]],
    first: int,
    count: int,
    width: int,
) -> tuple[list[str], list[str], frozenset[int]] | None:
    """Return names, units and the rows of both; ``None`` where there are none."""
    near = [at for at in range(first) if any(rows[at])][-_NEAR:]
    scoped = any(_is_increment(cell) for at in near for cell in rows[at])
    fitting: list[tuple[int, list[str]]] = []
    for at in reversed(near):
        row = [cell.lstrip("\ufeff") for cell in rows[at]]
        row = row[1:] if row[0] in _COMMENTS and len(row) == width + 1 else row
        row = [row[0].lstrip("#% ").strip() or row[0], *row[1:]]
        beside = scoped and all(not cell or _is_number(cell) or _is_increment(cell) for cell in row[count:])
        if _is_about(row[:count]):
            continue
        if count <= len(row) and (len(row) <= width or beside):
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
            if all(unit for _, unit in pairs):  # a line of key and value, such as `unit of rate;kHz`
                continue
            units = [unit or pair[1] for unit, pair in zip(_units(row), pairs, strict=True)]
            return names, units, frozenset({at, above})
        filled = [cell for cell in row if cell]
        if len(set(filled)) < len(filled):
            return [str(one) for one in range(count)], _units(row), frozenset({at})
    if (named := _names_over_units(fitting)) is not None:
        return named
    at, names = max(fitting, key=lambda one: (_may_name(one[1], marks[one[0]]), known[one[0]], one[0]))
    units = [split_header(name)[1] for name in names]
    return names, _scope_units(rows[:at], units), frozenset({at})


def _names_over_units(
    fitting: Sequence[tuple[int, list[str]]],
) -> tuple[list[str], list[str], frozenset[int]] | None:
    """Return names and units where a row of names stands over one of other names and units that repeat."""
    for (at, row), (above, names) in pairwise(fitting):
        places = [n for n, cell in enumerate(row) if is_unit(cell) and not is_unit(names[n])]
        alike = len({row[n] for n in places}) < len(places)
        if above == at - 1 and alike and len(set(names)) == len(names):
            return names, [cell if is_unit(cell) else "" for cell in row], frozenset({at, above})
    return None


def _keyed(rows: Sequence[Sequence[str]], count: int) -> tuple[list[str], list[str], frozenset[int]] | None:
    """Return names, units and rows of a header whose cells follow their keys, as of TwinCAT Scope.

    A column under a key holds the times of the next one, in ms.
    """
    heads = [at for at, row in enumerate(rows) if row[:1] == ["Name"] and len(row) >= max(count, 3)]
    if not heads or not any(row[:1] == ["Starttime of export"] for row in rows):
        return None
    at = heads[-1]
    below = {row[0]: row for row in rows[at + 1 :] if row}
    units = [re.sub(r"\s*\([A-Za-z ]+\)$", "", cell) for cell in below.get("Unit", [])]
    units += [""] * (count - len(units))
    names = ["time" if cell == "Name" else cell for cell in rows[at][:count]]
    units = ["ms" if cell == "Name" else unit for cell, unit in zip(rows[at], units, strict=False)][:count]
    neutral = {place for place in range(at, len(rows)) if "Scale" not in "".join(rows[place][:1])}
    return names, units, frozenset(neutral)


def _is_increment(cell: str) -> bool:
    """Return whether a cell names the start or increment of the times, as some oscilloscopes write it."""
    return bool(re.match(r"(?:start|increment|t0\s*=|tinc\s*=)", cell.lower()))


def _may_name(row: Sequence[str], marks: Sequence[Kind]) -> bool:
    """Return whether a row names more than half of the columns, and not by dates or numbers."""
    named = [
        kind
        for cell, kind in zip(row, marks, strict=False)
        if cell and (kind not in _TYPED or cell.isdigit())
    ]
    return 2 * len(named) > len(row)


def _is_known(cell: str) -> bool:
    name, unit = split_header(cell)
    words = re.split(r"[\W_]+", name.lower())
    return bool(unit) or any(word in known for word in words for known in WORDS.values())


def _are_units(row: Sequence[str]) -> bool:
    """Return whether a row holds units: one that is known, and else nothing that could be a name."""
    cells = [_bare(cell) for cell in row]
    if cells and cells[0].casefold() in _UNIT_WORDS:
        cells[0] = ""
    numbers = any(_is_number(cell) and cell not in NO_UNIT for cell in cells)
    cells = ["" if _is_number(cell) else cell for cell in cells]
    known = [cell for cell in cells if quantity_of(cell)]
    names = {word for words in WORDS.values() for word in words if not is_unit(word)}
    return (
        len(known) > numbers
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
    layout = layout_of(rows, marks, kinds, width, decimal)
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
        round(sum(data[at] for at in samples) / every, 2),
        round(numeric / max(1, sum(len(kinds) for _ in samples)), 2),
        float(not layout.numbered or layout.first == 0),
        float(not grouped or any(decimal in cell for column in columns for cell in column)),
        float(len(kinds)),
        float(decimal == "."),
    )
    by_name = zip(layout.names, columns, strict=True)
    hexadecimal = frozenset(name for name, cells in by_name if may_be_hexadecimal([*filter(None, cells)]))
    whole = frozenset(
        name
        for name, cells in zip(layout.names, columns, strict=True)
        if all(re.fullmatch(r"[-+]?\d+", cell) for cell in cells if cell)
    )
    return score, Dialect(delimiter, decimal, layout, kinds, grouped, doubtful, hexadecimal, whole)


def is_data(marks: Sequence[Kind]) -> bool:
    """Return whether a row is one of samples: numbers in it, and little text."""
    kinds = [kind for kind in marks if kind is not Kind.EMPTY]
    known = sum(kind is not Kind.TEXT for kind in kinds)
    return Kind.NUMBER in kinds and known >= DATA_SHARE * len(kinds)
