"""Blocks of a logger's record: stamps, sequence numbers that count gaps, the oil's temperature."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from spool_core.block import Block
from spool_core.cdr import OilTemperature
from spool_core.errors import InputError

from spool_bag.tables.column_names import BODY, OIL_TEMPERATURE, SPOOL

from .logger_record import LoggerRecord

#: s of a block, as the simulator and most drivers send them.
BLOCK_DURATION = 0.02
#: 2025-01-01T00:00:00Z: fixed, so that the same file always gives the same bag; 0 would read as "no time".
DEFAULT_START = 1_735_689_600_000_000_000
#: s: a time beyond three years is no time since the start but one of a calendar.
LONGEST_RECORD = 1e8
#: ns: seconds of a builtin_interfaces/Time are an int32.
LATEST_STAMP = 2**31 * 1_000_000_000
#: ns between oil temperatures: once a second, as a valve publishes it.
TEMPERATURE_INTERVAL = 1_000_000_000


def start_of(record: LoggerRecord) -> int:
    """Return the time (ns since 1970) from which a record counts: its own, 1970 itself, or the default."""
    if record.start is not None:
        return record.start
    return 0 if float(record.time[0]) > LONGEST_RECORD else DEFAULT_START


def checked_start(record: LoggerRecord, start: int | None) -> int:
    """Return ``start`` (ns), or that of the record, if every stamp can be held by a message.

    Raises:
        InputError: it cannot.
    """
    first, last = float(record.time[0]), float(record.time[-1])
    if start is None:
        start = start_of(record)
    elif first > LONGEST_RECORD:
        raise InputError(
            f"{record.path}: its time counts from 1970 itself ({first:.0f} s): leave --start out"
        )
    if start + first * 1e9 <= 0 or start + last * 1e9 >= LATEST_STAMP:
        raise InputError(
            f"{record.path}: stamps would be outside 1970 to 2038 (its time runs from {first:g} to "
            f"{last:g} s)"
        )
    return start


def blocks_of(
    record: LoggerRecord, start: int, block_duration: float = BLOCK_DURATION
) -> Iterator[tuple[int, Block]]:
    """Yield the index of its first sample and each block of ``record``, about ``block_duration`` s long.

    Raises:
        InputError: the duration is no number above 0.
    """
    if not (math.isfinite(block_duration) and block_duration > 0.0):
        raise InputError(f"block duration {block_duration} s: give a number above 0")
    size = max(round(block_duration / record.period), 1)
    body = record.columns[BODY].astype(np.float32, copy=False)
    spool = record.columns[SPOOL].astype(np.float32, copy=False)
    sequence = 0
    for begin, end in pairwise([0, *record.gaps.tolist(), record.time.size]):
        if begin > 0:
            missing = float(record.time[begin] - record.time[begin - 1]) - record.period
            sequence += max(round(missing / (size * record.period)), 1)
        firsts = np.arange(begin, end, size)
        stamps = start + np.rint(record.time[firsts] * 1e9).astype(np.int64)
        for first, stamp in zip(firsts.tolist(), stamps.tolist(), strict=True):
            last = min(first + size, end)
            yield first, Block(stamp, sequence, record.period, body[first:last], spool[first:last])
            sequence += 1


def stream_of(
    record: LoggerRecord, start: int, block_duration: float = BLOCK_DURATION
) -> Iterator[Block | OilTemperature]:
    """Yield blocks, and before each second of them the oil's temperature where it is known."""
    oil = record.columns.get(OIL_TEMPERATURE)
    due = -1
    for first, block in blocks_of(record, start, block_duration):
        if oil is not None and block.stamp >= due and math.isfinite(oil[first]):
            yield OilTemperature(block.stamp, float(oil[first]))
            due = block.stamp + TEMPERATURE_INTERVAL
        yield block
