"""LabVIEW's measurement files (LVM): channels with units, start and spacing in headers of segments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.csv_cells import pieces, shape_of
from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings
from spool_bag.importing.table import ArrayTable, Channel, Group, check_size, unique
from spool_bag.importing.units import split_header

_BEGIN = b"LabVIEW Measurement"
_END = "***End_of_Header***"
#: Keys of the headers that are used, or say how the file is written.
_TAKEN = (
    "LabVIEW Measurement", _END, "Writer_Version", "Reader_Version", "Separator", "Decimal_Separator",
    "Multi_Headings", "X_Columns", "Time_Pref", "Date", "Time", "Channels", "Samples", "Y_Unit_Label",
    "X_Dimension", "X0", "Delta_X",
)  # fmt: skip


@dataclass(slots=True)
class _Segment:
    """Header by key, names of its columns, rows of cells, and the line of the first of them."""

    header: dict[str, list[str]]
    columns: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    line: int = 0


@dataclass(slots=True)
class _Signal:
    """Signal of a channel: values, and their times from the file's start (s)."""

    name: str
    unit: str
    values: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    steps: set[float] = field(default_factory=set)
    start: int | None = None


def opened(path: Path) -> ArrayTable:
    """Return the channels of a file; segments follow each other in time as their headers say.

    Raises:
        InputError: no channel in it, or a cell that is no number.
    """
    check_size(path)
    text, warnings, notes = "", [], []
    for piece in pieces(path):
        text += piece.content.decode("utf-8", "replace")
        warnings += [piece.damage] if piece.damage else []
        notes = [piece.note] if piece.note else []
    whole = text.endswith("\n")
    lines = text.replace("\r", "").split("\n")
    top, separator, decimal = _file_header(path, lines)
    segments = _segments(lines, top, separator)
    if not whole and segments and segments[-1].rows:
        warnings += _without_cut_row(segments[-1], decimal)
    over = {cell for one in segments for cell in one.header.get("X_Dimension", []) if cell} - {"Time"}
    if over:
        raise InputError(
            f"{path}: its samples are over {printable(' and '.join(sorted(over)), 60)}, not over time: "
            "export signals over time"
        )
    ways = {"one": "one", "multi": "multi"}.get(_setting(lines, "X_Columns", separator).lower(), "no")
    signals: dict[int, _Signal] = {}
    for segment in segments:
        warnings += _take(path, segment, ways, decimal, signals)
    if not signals:
        raise InputError(f"{path}: no channel with samples in it")
    comma = "comma" if decimal == "," else "point"
    found = _table(path, signals, [*notes, f"LabVIEW measurement file, decimal {comma}"], warnings)
    stated = {
        cells[0]: ", ".join(filter(None, cells[1:]))
        for cells in (line.split(separator) for line in lines[:top])
    }
    for segment in segments:
        stated |= {key: ", ".join(filter(None, cells)) for key, cells in segment.header.items()}
    found.settings = Settings({key: text for key, text in stated.items() if key not in _TAKEN and text})
    return found


def _file_header(path: Path, lines: Sequence[str]) -> tuple[int, str, str]:
    """Return the line below the file's header, and the marks between columns and in numbers."""
    end = next((at for at, line in enumerate(lines) if line.startswith(_END)), None)
    if end is None:
        raise InputError(f"{path}: its header has no end: the file is cut off: copy it again")
    comma = _setting(lines[:end], "Separator", "\t") or _setting(lines[:end], "Separator", ",")
    separator = "," if comma.lower() == "comma" else "\t"
    return end + 1, separator, _setting(lines[:end], "Decimal_Separator", separator) or "."


def _setting(lines: Sequence[str], key: str, separator: str) -> str:
    found = (line.split(separator) for line in lines if line.startswith(key + separator))
    return next((cells[1].strip() for cells in found if len(cells) > 1), "")


def _segments(lines: Sequence[str], top: int, separator: str) -> list[_Segment]:
    found: list[_Segment] = []
    header: dict[str, list[str]] = {}
    inside = special = False
    for number, line in enumerate(lines[top:], start=top + 1):
        if line.startswith("***Start_Special***") or special:
            special = not line.startswith("***End_Special***")
            continue
        cells = [cell.strip() for cell in line.split(separator)]
        if line.startswith(_END):
            found.append(_Segment(header))
            header, inside = {}, True
        elif not any(cells):
            continue
        elif cells[0] == "Channels" or not inside:  # the header of the next segment
            inside = False
            header[cells[0]] = cells[1:]
        elif not found[-1].columns:
            found[-1].columns, found[-1].line = cells, number + 1
        else:
            found[-1].rows.append(cells)
    return found


def _without_cut_row(segment: _Segment, decimal: str) -> list[str]:
    """Take the last row away where the file stops within it; return a warning."""
    *above, last = segment.rows
    shapes = {shape_of(cell, decimal) for row in above[-200:] for cell in row[-1:]}
    usual = min((len(row) for row in above[-200:]), default=0)
    if len(last) >= usual and (not shapes or shape_of(last[-1], decimal) in shapes):
        return []
    segment.rows = above
    return [f"left out at the file's end, since it holds no whole sample: {printable(last, 60)}"]


def _take(path: Path, segment: _Segment, ways: str, decimal: str, signals: dict[int, _Signal]) -> list[str]:
    """Append a segment's samples to the signals of its columns; return warnings."""
    columns = segment.columns[:-1] if segment.columns[-1:] == ["Comment"] else segment.columns
    places = list(range(1, len(columns), 2 if ways == "multi" else 1))
    counts, units, steps, begins, dates, clocks = (
        _of_channels(segment.header.get(key, []), places)
        for key in ("Samples", "Y_Unit_Label", "Delta_X", "X0", "Date", "Time")
    )
    warnings = []
    for at, place in enumerate(places):
        name = columns[place]
        signal = signals.setdefault(place, _Signal(name, units[at] or split_header(name)[1]))
        rows = [row for row in segment.rows if place < len(row) and row[place]]
        try:
            values = [float(row[place].replace(decimal, ".")) for row in rows]
            if ways == "no":
                step = float(steps[at].replace(decimal, "."))
                start = _start(dates[at], clocks[at])
                signal.start = start if signal.start is None else signal.start
                since = 0.0 if start is None or signal.start is None else 1e-9 * (start - signal.start)
                begin = float((begins[at] or "0").replace(decimal, ".")) + since
                own = [begin + step * index for index in range(len(values))]
                signal.steps.add(step)
            else:
                own = [float(row[place - 1 if ways == "multi" else 0].replace(decimal, ".")) for row in rows]
        except ValueError as error:
            raise InputError(
                f"{path}: {printable(name, 40)}, from line {segment.line} on: {printable(error, 80)}"
            ) from error
        signal.values += values
        signal.times += own
        stated = counts[at]
        if stated.isdigit() and int(stated) != len(values):
            few = "of" if int(stated) > len(values) else "samples, and the header states"
            text = f"{printable(name, 40)} holds {len(values)} {few} {stated} samples"
            warnings.append(f"{text}: is the file cut off?" if few == "of" else text)
    return warnings


def _of_channels(cells: Sequence[str], places: Sequence[int]) -> list[str]:
    """Return the cells of a header's line by channel: beside its column, or in succession."""
    filled = [cell for cell in cells if cell]
    if len(filled) == len(places):
        return filled
    return [cells[place - 1] if place - 1 < len(cells) else "" for place in places]


def _start(date: str, clock: str) -> int | None:
    """Return ns since 1970 of `2026/05/04` and `09:51:40,72`, ``None`` where there is no date."""
    try:
        whole, _, fraction = clock.replace(",", ".").partition(".")
        moment = datetime.strptime(f"{date} {whole}", "%Y/%m/%d %H:%M:%S").replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    return round(moment.timestamp()) * 1_000_000_000 + int(f"{fraction[:9]:0<9}" or 0)


def _table(
    path: Path, signals: dict[int, _Signal], notes: Sequence[str], warnings: Sequence[str]
) -> ArrayTable:
    """Return groups of signals that have the same times."""
    names = unique([signal.name for signal in signals.values()])
    clocks: dict[tuple[float | None, ...], list[tuple[int, str, _Signal]]] = {}
    for (place, signal), name in zip(signals.items(), names, strict=True):
        first, last = (signal.times[0], signal.times[-1]) if signal.times else (math.nan, math.nan)
        clocks.setdefault((len(signal.values), first, last, signal.start), []).append((place, name, signal))
    groups: list[Group] = []
    arrays: dict[tuple[str, str], Any] = {}
    for at, held in enumerate(clocks.values()):
        group = "" if len(clocks) == 1 else f"clock {at + 1}"
        time = np.array(held[0][2].times)
        step = next(iter(held[0][2].steps)) if len(held[0][2].steps) == 1 else math.nan
        regular = step > 0.0 and bool(np.all(np.abs(np.diff(time) - step) < 0.5 * step))
        channels = [
            Channel(name, signal.unit, number=place, own="" if name == signal.name else signal.name)
            for place, name, signal in held
        ]
        arrays |= {(group, name): np.array(signal.values) for _, name, signal in held}
        if not regular:
            channels.insert(0, Channel("X_Value", "s", time=True, number=0))
            arrays[group, "X_Value"] = time
        groups.append(
            Group(
                group,
                tuple(channels),
                1.0 / step if regular else math.nan,
                held[0][2].start,
                stamped=regular,
                source="Delta_X" if regular else "",
                delay=float(time[0]) if regular else 0.0,
            )
        )
    return ArrayTable(path, tuple(groups), arrays, tuple(notes), tuple(warnings))


FORMAT = Format("LabVIEW LVM", (".lvm",), opened, begins=(_BEGIN, b"\xef\xbb\xbf" + _BEGIN))
