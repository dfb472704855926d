"""Import of a data logger's record into a bag."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from spool_stream.block import Block
from spool_stream.errors import InputError

from spool_bag.format.cdr import OilTemperature, encode_block, encode_temperature
from spool_bag.format.definitions import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.names import check_valve
from spool_bag.recording.writer import BagWriter

from .csv_record import BODY, OIL_TEMPERATURE, SPOOL, CsvRecord, read_csv

# 2025-01-01T00:00:00Z: fixed, so that the same file always gives the same bag; 0 would read as "no time".
DEFAULT_START = 1_735_689_600_000_000_000
# A time_s beyond three years is no time since the start but one of a calendar.
LONGEST_RECORD = 1e8
# ns: seconds of a builtin_interfaces/Time are an int32.
LATEST_STAMP = 2**31 * 1_000_000_000
# ns between oil temperatures: once a second, as a valve publishes it.
TEMPERATURE_INTERVAL = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ImportResult:
    """Result of an import: ``lost_blocks`` stand for gaps, ``period`` and ``duration`` are in s."""

    bag: Path
    valve: str
    samples: int
    blocks: int
    lost_blocks: int
    temperatures: int
    period: float
    duration: float
    warnings: tuple[str, ...]


def import_csv(
    path: Path | str,
    out: Path | str,
    *,
    valve: str = "valve_1",
    columns: Mapping[str, str] | None = None,
    block_duration: float = 0.02,
    start: int | None = None,
) -> ImportResult:
    """Write the CSV record ``path`` as the bag ``out``.

    Stamps are ``start`` (ns since 1970) plus the column ``time_s``; the default is ``DEFAULT_START``, or 0
    where ``time_s`` counts from 1970 itself. Accelerations become float32. A gap ends a block and is counted
    as lost blocks by a jump in ``sequence``.

    Raises:
        InputError: the record, the valve's name or the target cannot be used.
        RecordingError: the bag cannot be written on.
    """
    check_valve(valve)
    if not (math.isfinite(block_duration) and block_duration > 0.0):
        raise InputError(f"block duration {block_duration} s: give a number above 0")
    record = read_csv(path, columns=columns)
    start = _checked_start(path, record, start)
    blocks = newest = temperatures = 0
    with BagWriter(out, staged=True) as writer:
        channel = writer.add_topic(f"/{valve}/acceleration", ACCELERATION_BLOCK)
        oil = record.columns.get(OIL_TEMPERATURE)
        thermal = writer.add_topic(f"/{valve}/oil_temperature", TEMPERATURE) if oil is not None else 0
        due = -1
        for first, block in blocks_of(record, start, block_duration):
            if oil is not None and block.stamp >= due and math.isfinite(oil[first]):
                item = OilTemperature(block.stamp, float(oil[first]))
                writer.write(thermal, block.stamp, encode_temperature(item, valve))
                due = block.stamp + TEMPERATURE_INTERVAL
                temperatures += 1
            writer.write(
                channel, block.stamp, encode_block(block, valve), sequence=block.sequence & 0xFFFFFFFF
            )
            blocks += 1
            newest = block.sequence
    duration = float(record.time[-1] - record.time[0]) + record.period
    return ImportResult(
        Path(out),
        valve,
        record.time.size,
        blocks,
        newest + 1 - blocks,
        temperatures,
        record.period,
        duration,
        record.warnings,
    )


def _checked_start(path: Path | str, record: CsvRecord, start: int | None) -> int:
    """Return ``start`` (ns), or the default of ``record``, if every stamp can be held by a message."""
    first, last = float(record.time[0]), float(record.time[-1])
    if start is None:
        start = start_of(record)
    elif first > LONGEST_RECORD:
        raise InputError(f"{path}: time_s counts from 1970 itself ({first:.0f} s): leave --start out")
    if start + first * 1e9 <= 0 or start + last * 1e9 >= LATEST_STAMP:
        raise InputError(f"{path}: stamps would be outside 1970 to 2038 (time_s from {first:g} to {last:g})")
    return start


def start_of(record: CsvRecord) -> int:
    """Return the time (ns since 1970) from which ``record`` counts: 1970 itself, or ``DEFAULT_START``."""
    return 0 if float(record.time[0]) > LONGEST_RECORD else DEFAULT_START


def blocks_of(record: CsvRecord, start: int, block_duration: float) -> Iterator[tuple[int, Block]]:
    """Yield the index of its first sample and each block of ``record``, about ``block_duration`` s long."""
    size = max(round(block_duration / record.period), 1)
    body = record.columns[BODY].astype(np.float32)
    spool = record.columns[SPOOL].astype(np.float32)
    sequence = 0
    edges = [0, *record.gaps.tolist(), record.time.size]
    for begin, end in pairwise(edges):
        if begin > 0:
            missing = float(record.time[begin] - record.time[begin - 1]) - record.period
            sequence += max(round(missing / (size * record.period)), 1)
        for first in range(begin, end, size):
            last = min(first + size, end)
            stamp = start + round(float(record.time[first]) * 1e9)
            yield first, Block(stamp, sequence, record.period, body[first:last], spool[first:last])
            sequence += 1
