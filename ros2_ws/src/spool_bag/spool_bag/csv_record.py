"""Read a data logger's CSV file into arrays and judge it."""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
from numpy.typing import NDArray
from spool_stream.errors import InputError

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

GAP = 1.5
JITTER = 0.25
GRAVITY = 9.80665
LARGEST_USUAL_RMS = 2000.0
LONGEST_USUAL_PERIOD = 0.05

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CsvRecord:
    """A record as arrays of shape (n,).

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
    text = _text(path)
    found = text.header
    missing = [names[name] for name in REQUIRED[kind] if names[name] not in found]
    if missing:
        mapping = f"{REQUIRED[kind][1]}=NAME"
        raise InputError(
            f"{path}: no column {', '.join(missing)}; it has {', '.join(found)}: "
            f"map names with --columns {mapping}"
        )
    absent = [own for name, own in names.items() if columns and name in columns and own not in found]
    if absent:
        raise InputError(f"{path}: no column {', '.join(absent)}; it has {', '.join(found)}")
    present = {name: own for name, own in names.items() if own in found}
    doubled = [own for own in present.values() if found.count(own) > 1]
    if doubled:
        raise InputError(f"{path}: column {doubled[0]} is there {found.count(doubled[0])} times")
    table = _table(text, list(dict.fromkeys(present.values())))
    arrays = {
        name: _numbers(path, own, table.column(own), holes=name == OIL_TEMPERATURE)
        for name, own in present.items()
    }
    time = arrays.pop(TIME)
    period, gaps, warnings = _timing(path, time) if regular else _loose_timing(path, time)
    if period > LONGEST_USUAL_PERIOD:
        warnings.append(f"{TIME} steps by {period:g} s: are these milliseconds?")
    if kind == "accelerations":
        warnings += _units(arrays)
    return CsvRecord(time, arrays, period, gaps, tuple(warnings))


@dataclass(frozen=True, slots=True)
class _Text:
    """A file as read: its bytes, the names in its header and how it separates."""

    path: Path
    content: bytes
    header: list[str]
    delimiter: str
    decimal: str


def _text(path: Path) -> _Text:
    try:
        with path.open("rb") as plain:
            packed = plain.read(2) == b"\x1f\x8b"
            plain.seek(0)
            stream = cast(BinaryIO, gzip.GzipFile(fileobj=plain)) if packed else plain
            content = stream.read()
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(
            f"{path}: the compressed file is cut off or damaged ({error}): copy it again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not content.strip():
        raise InputError(f"{path}: the file is empty")
    first, _, rest = content.partition(b"\n")
    if not rest.strip():
        raise InputError(f"{path}: 0 samples are too few for a record")
    line = first.decode("utf-8-sig", "replace")
    delimiter = max(",;\t", key=line.count)
    decimal = "," if delimiter != "," and b"," in rest.partition(b"\n")[0] else "."
    header = [cell.strip().strip('"').strip() for cell in line.split(delimiter)]
    return _Text(path, content, header, delimiter, decimal)


def _table(text: _Text, wanted: list[str]) -> pa.Table:
    try:
        return pa_csv.read_csv(
            pa.BufferReader(text.content),
            read_options=pa_csv.ReadOptions(column_names=text.header, skip_rows=1, use_threads=False),
            parse_options=pa_csv.ParseOptions(delimiter=text.delimiter),
            convert_options=pa_csv.ConvertOptions(
                column_types={name: pa.float64() for name in wanted},
                include_columns=wanted,
                decimal_point=text.decimal,
            ),
        )
    except pa.ArrowInvalid as error:
        raise InputError(f"{text.path}: {_first_bad_line(text, wanted) or error}") from error


def _first_bad_line(text: _Text, wanted: list[str]) -> str | None:
    """Return where the first row stands that is no row of numbers; only called once parsing failed."""
    for number, line in enumerate(text.content.decode("utf-8", "replace").splitlines()[1:], start=2):
        if not line.strip():
            continue
        cells = line.split(text.delimiter)
        if len(cells) != len(text.header):
            return f"line {number} has {len(cells)} cells, the header has {len(text.header)}"
        for name, cell in zip(text.header, cells, strict=True):
            try:
                float(cell.strip('" ').replace(text.decimal, ".") or "nan")
            except ValueError:
                if name in wanted:
                    return f"line {number}: {name} is {cell!r}, not a number"
    return None


def _numbers(path: Path, name: str, column: pa.ChunkedArray, *, holes: bool) -> Array:
    """Return the column as numbers; with ``holes`` empty cells are NaN, else they are an error."""
    values = np.asarray(column.to_numpy(), dtype=np.float64)
    bad = np.flatnonzero(np.isinf(values) if holes else ~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"{path}: line {bad[0] + 2}: {name} is empty, NaN or infinite ({bad.size} such cells)"
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
