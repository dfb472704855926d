"""CSV record of a data logger: reading into arrays, and plausibility."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray
from spool_stream.block_gate import SHORTEST_PERIOD
from spool_stream.errors import InputError
from spool_stream.text.printable import printable

from .csv_text import LONGEST_LINE, Dialect, TextPiece, dialect, listed, pieces

TIME = "time_s"
BODY = "body_m_s2"
SPOOL = "spool_m_s2"
OIL_TEMPERATURE = "oil_temperature_C"
DISPLACEMENT = "displacement_m"
FORCE = "force_N"

REQUIRED = {
    "accelerations": (TIME, BODY, SPOOL),
    "driven": (TIME, DISPLACEMENT, FORCE),
    "imposed": (TIME, DISPLACEMENT, FORCE),
}
OPTIONAL = {"accelerations": (OIL_TEMPERATURE,), "driven": (), "imposed": ()}

#: Periods: a longer step is a gap, one missing sample makes two; a sample further off its place is refused.
GAP = 1.5
JITTER = 0.25
#: m/s^2, standard gravity (ISO 80000-3).
GRAVITY = 9.80665
#: m/s^2, some 200 g: hardly any machine shakes a valve like that.
LARGEST_USUAL_RMS = 2000.0
#: s: at 20 Hz not even 10 Hz can be seen, below any spool valve's natural frequency.
LONGEST_USUAL_PERIOD = 0.05
#: s, of a force record, which may be as slow as its machine.
LONGEST_PERIOD = 10.0
#: Beyond any acceleration, force, displacement or time in ns since 1970.
LARGEST_NUMBER = 1e19
#: 100 min at 2 kHz: with what judging them needs 64 B a sample, 800 MB.
MOST_SAMPLES = 12_000_000

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CsvRecord:
    """CSV record as arrays of shape (n,).

    ``time`` is in s and increases, ``columns`` are by contract name in the unit of that name, ``period``
    in s is the sampling period. ``gaps`` holds the index of each first sample after a gap, ``warnings`` one
    line each.
    """

    time: Array
    columns: dict[str, Array]
    period: float
    gaps: NDArray[np.int64]
    warnings: tuple[str, ...]


def read_csv(
    path: Path | str,
    kind: str = "accelerations",
    columns: Mapping[str, str] | None = None,
    *,
    regular: bool = True,
) -> CsvRecord:
    """Read ``path`` (.csv or .csv.gz) as a record of ``kind`` (a key of ``REQUIRED``).

    ``columns`` maps contract names to the file's own, e.g. ``{"time_s": "t"}``. With ``regular`` False times
    may be spaced as they like; the period is then their median step, a gap ten times that.

    Raises:
        InputError: what is wrong, with the line where there is one.
    """
    path = Path(path)
    names = {name: name for name in (*REQUIRED[kind], *OPTIONAL[kind])}
    for name, own in (columns or {}).items():
        if name not in names:
            raise InputError(f"--columns: {name!r} is not one of {', '.join(names)}")
        names[name] = own
    header, read = _table(path, lambda found: _chosen(path, found, names, kind, columns))
    present = {name: own for name, own in names.items() if own in header}
    arrays = {
        name: _numbers(path, own, np.concatenate(read[own]), holes=name == OIL_TEMPERATURE)
        for name, own in present.items()
    }
    read.clear()
    time = arrays.pop(TIME)
    period, gaps, warnings = _timing(path, time) if regular else _loose_timing(path, time)
    _check_period(path, period, slowest=LONGEST_USUAL_PERIOD if kind == "accelerations" else LONGEST_PERIOD)
    if period > LONGEST_USUAL_PERIOD:
        warnings.append(f"{TIME} steps by {period:g} s: are these {_unit_of_time(period)}?")
    if kind == "accelerations":
        warnings += _units(arrays)
    return CsvRecord(time, arrays, period, gaps, tuple(warnings))


def _chosen(
    path: Path, found: list[str], names: Mapping[str, str], kind: str, columns: Mapping[str, str] | None
) -> list[str]:
    """Return the file's own names of the columns to read.

    Raises:
        InputError: one is missing or there several times.
    """
    missing = [names[name] for name in REQUIRED[kind] if names[name] not in found]
    if missing:
        raise InputError(
            f"{path}: no column {listed(missing)}; it has {listed(found)}: "
            f"map names with --columns {REQUIRED[kind][1]}=NAME"
        )
    absent = [own for name, own in names.items() if columns and name in columns and own not in found]
    if absent:
        raise InputError(f"{path}: no column {listed(absent)}; it has {listed(found)}")
    present = [own for own in names.values() if own in found]
    doubled = [own for own in present if found.count(own) > 1]
    if doubled:
        raise InputError(f"{path}: column {listed(doubled[:1])} is there {found.count(doubled[0])} times")
    return list(dict.fromkeys(present))


def _check_period(path: Path, period: float, *, slowest: float) -> None:
    """Raise InputError where the time is hardly in s: an error by 1000 would go through every number."""
    if not SHORTEST_PERIOD <= period <= slowest:
        raise InputError(
            f"{path}: {TIME} steps by {period:g} s: are these {_unit_of_time(period)}? give the time in s, "
            f"and the samples of a valve at more than {1.0 / LONGEST_USUAL_PERIOD:g} Hz"
        )


def _unit_of_time(period: float) -> str:
    """Return the unit in which ``period`` would be plausible."""
    units = {
        "milliseconds": 1e-3,
        "microseconds": 1e-6,
        "nanoseconds": 1e-9,
        "minutes": 60.0,
        "hours": 3600.0,
    }
    plausible = [unit for unit, size in units.items() if 1e-5 <= period * size <= LONGEST_USUAL_PERIOD]
    return plausible[0] if plausible else "seconds"


def _table(path: Path, wanted: Callable[[list[str]], list[str]]) -> tuple[list[str], dict[str, list[Array]]]:
    """Return the names in the file's header and pieces of the ``wanted`` columns among them, as numbers."""
    found: Dialect | None = None
    columns: dict[str, list[Array]] = {}
    rows = 0
    for piece in pieces(path):
        content, line = piece.content, piece.line
        if found is None:
            if not content.strip():
                raise InputError(f"{path}: the file is empty")
            first, _, content = content.partition(b"\n")
            if not content.strip():
                raise InputError(f"{path}: 0 samples are too few for a record")
            found = dialect(path, first, content[: LONGEST_LINE + 1].partition(b"\n")[0])
            line += 1
            columns = {name: [] for name in wanted(found.header)}
        if not content.strip():
            continue
        table = _parse(path, TextPiece(content, line), found, list(columns))
        rows += table.num_rows
        if rows > MOST_SAMPLES:
            raise InputError(f"{path}: more than {MOST_SAMPLES} samples: split the file and import each part")
        for name, parts in columns.items():
            parts.append(np.asarray(table.column(name).to_numpy(), dtype=np.float64))
    if found is None:
        raise InputError(f"{path}: the file is empty")
    return found.header, columns


def _parse(path: Path, piece: TextPiece, found: Dialect, wanted: list[str]) -> pa.Table:
    try:
        return pa_csv.read_csv(
            pa.BufferReader(piece.content),
            read_options=pa_csv.ReadOptions(
                column_names=found.header, use_threads=False, block_size=len(piece.content) + 1
            ),
            parse_options=pa_csv.ParseOptions(delimiter=found.delimiter),
            convert_options=pa_csv.ConvertOptions(
                column_types={name: pa.float64() for name in wanted},
                include_columns=wanted,
                decimal_point=found.decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        where = _first_bad_line(piece, found, wanted) or printable(error, 200)
        raise InputError(f"{path}: {where}") from error


def _first_bad_line(piece: TextPiece, found: Dialect, wanted: list[str]) -> str | None:
    """Return where the first row stands that is no row of numbers; only called once parsing failed."""
    lines = piece.content.decode("utf-8", "replace").split("\n")
    for number, line in enumerate(lines, start=piece.line):
        if not line.strip():
            continue
        cells = line.split(found.delimiter)
        if len(cells) != len(found.header):
            return f"line {number} has {len(cells)} cells, the header has {len(found.header)}"
        for name, cell in zip(found.header, cells, strict=True):
            try:
                float(cell.strip('" \r').replace(found.decimal, ".") or "nan")
            except ValueError:
                if name in wanted:
                    return f"line {number}: {printable(name, 40)} is {printable(cell, 40)!r}, not a number"
    return None


def _numbers(path: Path, name: str, values: Array, *, holes: bool) -> Array:
    """Return ``values``; with ``holes`` empty cells are NaN, else they are an error."""
    name = printable(name, 40)
    bad = np.flatnonzero(np.isinf(values) if holes else ~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"{path}: line {bad[0] + 2}: {name} is empty, NaN or infinite ({bad.size} such cells)"
        )
    huge = np.flatnonzero(np.abs(values) > LARGEST_NUMBER)
    if huge.size:
        raise InputError(
            f"{path}: line {huge[0] + 2}: {name} is {values[huge[0]]:g}, which nothing measures "
            f"({huge.size} such cells)"
        )
    return values


def _timing(path: Path, time: Array) -> tuple[float, NDArray[np.int64], list[str]]:
    if time.size < 3:
        raise InputError(f"{path}: {time.size} samples are too few for a record")
    steps = np.diff(time)
    back = np.flatnonzero(steps <= 0.0)
    if back.size:
        line = int(back[0]) + 3
        raise InputError(f"{path}: line {line}: {TIME} does not increase ({time[back[0] + 1]:g} s)")
    gaps = np.flatnonzero(steps > GAP * float(np.median(steps))) + 1
    regular = np.delete(steps, gaps - 1)
    if regular.size < 2:
        raise InputError(f"{path}: {TIME} is not sampled regularly: resample it to a constant period")
    period = sampling_period(regular)
    jitter = float(np.max(np.abs(regular - period)))
    # Printed times are rounded: half a last digit at each end is no jitter.
    if jitter > JITTER * period + _resolution(time):
        at = int(
            np.argmax(np.abs(np.where(np.isin(np.arange(steps.size), gaps - 1), period, steps) - period))
        )
        raise InputError(
            f"{path}: line {at + 3}: sampling is irregular, a step of {steps[at]:g} s where {period:g} s "
            "is usual: resample it to a constant period"
        )
    warnings = []
    if gaps.size:
        missing = float(np.sum(steps[gaps - 1] - period))
        warnings.append(f"{gaps.size} gaps in {TIME}, {missing:g} s missing; first at line {gaps[0] + 2}")
    return period, gaps.astype(np.int64), warnings


def _loose_timing(path: Path, time: Array) -> tuple[float, NDArray[np.int64], list[str]]:
    steps = np.diff(time)
    if time.size < 3 or (steps <= 0.0).any():
        return _timing(path, time)  # says what is wrong
    period = float(np.median(steps))
    gaps = np.flatnonzero(steps > 10.0 * period) + 1
    warnings = [f"{gaps.size} gaps in {TIME}, longer than {10.0 * period:g} s"] if gaps.size else []
    uneven = float(np.quantile(np.abs(steps - period), 0.99))
    if uneven > JITTER * period + _resolution(time):
        warnings.append(f"{TIME} is spaced unevenly, by up to {uneven:.3g} s: resampled")
    return period, gaps.astype(np.int64), warnings


def sampling_period(steps: Array) -> float:
    """Return the period (s) behind ``steps`` (s) that were printed with few decimals.

    The mean is exact to one digit of print over the whole record; the roundest rate in whole Hz, or a
    period in whole microseconds, within that is what the logger was set to.
    """
    mean = float(np.mean(steps))
    tolerance = max(2.0 * float(np.ptp(steps)) / steps.size, 1e-7 * mean)
    for digits in (-3, -2, -1, 0):
        rate = round(1.0 / mean, digits)
        if rate > 0.0 and abs(1.0 / rate - mean) <= tolerance:
            return 1.0 / rate
    rounded = round(mean * 1e6) / 1e6
    return rounded if rounded > 0.0 and abs(rounded - mean) <= tolerance else mean


def _resolution(time: Array) -> float:
    """Return the last digit (s) in which ``time`` was printed, 1e-12 where it is finer."""
    probe = time[: min(time.size, 200)]
    for decimals in range(3, 12):
        if np.allclose(probe, np.round(probe, decimals), rtol=0.0, atol=1e-13):
            return float(10.0**-decimals)
    return 1e-12


def _units(columns: Mapping[str, Array]) -> list[str]:
    warnings = []
    size = {name: float(np.sqrt(np.mean(np.square(columns[name])))) for name in (BODY, SPOOL)}
    for name, rms in size.items():
        if rms > LARGEST_USUAL_RMS:
            warnings.append(f"{name} has an rms of {rms:.0f} m/s^2: are these mm/s^2 or raw counts?")
    if min(size.values()) > 0.0:
        ratio = math.log(size[SPOOL] / size[BODY])
        if abs(abs(ratio) - math.log(GRAVITY)) < 0.02:
            smaller = BODY if ratio > 0.0 else SPOOL
            warnings.append(f"body and spool differ by a factor of 9.81: is {smaller} in g instead of m/s^2?")
    return warnings
