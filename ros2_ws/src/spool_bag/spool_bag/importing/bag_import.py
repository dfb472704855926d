"""Import of a record into a bag: its samples in blocks, with where each comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from spool_core import cdr
from spool_core.block import Block
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag import BODY, COMMAND, OIL_TEMPERATURE, SPEED, SPOOL, check_valve
from spool_bag.importing.choices import Choices
from spool_bag.importing.logger_record import LoggerRecord, read_record
from spool_bag.importing.time_axis import ClockOffset
from spool_bag.metadata import ACCELERATION_BLOCK, FLOAT64, RATE_STD, TEMPERATURE, custom_data
from spool_bag.writer import BagWriter

#: Begin of the keys of ``custom_data`` that hold columns and their conversions.
_COLUMN = "import_column_"

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
#: ns between speeds: orders are tracked between them along straight lines.
SPEED_INTERVAL = 100_000_000


@dataclass(frozen=True, slots=True)
class ImportResult:
    """Result of an import: ``lost_blocks`` stand for gaps, ``period`` and ``duration`` are in s.

    ``warnings``, ``notes``: what is not as it should be, and how the files were understood. ``clocks``: how
    two clocks were brought together.
    """

    bag: Path
    valve: str
    samples: int
    blocks: int
    lost_blocks: int
    temperatures: int
    period: float
    duration: float
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    clocks: ClockOffset | None


def import_record(
    paths: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    valve: str = "valve_1",
    columns: Mapping[str, str] | None = None,
    how: Choices | None = None,
    block_duration: float = BLOCK_DURATION,
    start: int | None = None,
) -> ImportResult:
    """Write a record, one file or one of each sensor, as the bag ``out``.

    Stamps are ``start`` (ns since 1970) plus the record's time; the default is what the file states, or
    ``DEFAULT_START``. Accelerations become float32. A gap ends a block and is counted as lost blocks by a
    jump
    in ``sequence``. What was repaired, and between which clocks, stands in the bag's ``custom_data``.

    Raises:
        InputError: the record, the valve's name or the target cannot be used.
        RecordingError: the bag cannot be written on.
    """
    check_valve(valve)
    record = read_record(paths, columns=columns, how=how, single=True)
    begin = checked_start(record, start)
    next(blocks_of(record, begin, block_duration))  # refuses a duration before anything is made
    blocks = newest = temperatures = 0
    with BagWriter(out, staged=True, custom=provenance(record)) as writer:
        channel = writer.add_topic(f"/{valve}/acceleration", ACCELERATION_BLOCK)
        thermal, turning = OIL_TEMPERATURE in record.columns, SPEED in record.columns
        oil = writer.add_topic(f"/{valve}/oil_temperature", TEMPERATURE) if thermal else 0
        speed = writer.add_topic(f"/{valve}/speed", FLOAT64) if turning else 0
        command = writer.add_topic(f"/{valve}/command", FLOAT64) if COMMAND in record.columns else 0
        for item in stream_of(record, begin, block_duration):
            if isinstance(item, cdr.OilTemperature):
                writer.write(oil, item.stamp, cdr.encode_temperature(item, valve))
                temperatures += 1
                continue
            if isinstance(item, cdr.Speed | cdr.Command):
                number = item.rpm if isinstance(item, cdr.Speed) else item.value
                topic = speed if isinstance(item, cdr.Speed) else command
                writer.write(topic, item.stamp, cdr.encode_speed(cdr.Speed(item.stamp, number)))
                continue
            count = item.sequence & 0xFFFFFFFF
            writer.write(channel, item.stamp, cdr.encode_block(item, valve), sequence=count)
            blocks += 1
            newest = item.sequence
    return ImportResult(
        Path(out),
        valve,
        record.time.size,
        blocks,
        newest + 1 - blocks,
        temperatures,
        record.period,
        record.duration,
        record.warnings,
        record.notes,
        record.clocks,
    )


def import_notes(bag: Path) -> tuple[str, ...]:
    """Return from which columns a bag was imported, and how they were converted; empty for a recorded bag."""
    held = custom_data(bag)
    uses = [text for key, text in held.items() if key.startswith(_COLUMN)]
    return (f"imported from {printable(held.get('imported_from', ''), 80)}", *uses) if uses else ()


def provenance(record: LoggerRecord) -> dict[str, str]:
    """Return what a bag keeps of how its record was understood, by key."""
    found = {"imported_from": record.path.name}
    if record.rate_std > 0.0:
        found[RATE_STD] = f"{record.rate_std:.3g}"
    found |= {f"{_COLUMN}{use.role}": str(use) for use in record.uses}
    found |= {f"import_{name}": str(count) for name, count in record.repairs.items()}
    if record.clocks is not None:
        clocks = record.clocks
        found |= {
            "import_clock_offset_s": f"{clocks.offset:.9g}",
            "import_clock_offset_std_s": f"{clocks.offset_std:.3g}",
            "import_clock_drift_ppm": f"{1e6 * clocks.drift:.6g}",
            "import_clock_drift_std_ppm": f"{1e6 * clocks.drift_std:.3g}",
        }
    return found


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
    given = "" if start is None else " from --start on"
    if start is None:
        start = start_of(record)
    elif first > LONGEST_RECORD:
        raise InputError(
            f"{record.path}: its time counts from 1970 itself ({first:.0f} s): leave --start out"
        )
    if start + first * 1e9 <= 0 or start + last * 1e9 >= LATEST_STAMP:
        raise InputError(
            f"{record.path}: stamps would be outside 1970 to 2038{given} (its time runs from {first:g} to "
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
) -> Iterator[Block | cdr.Reading]:
    """Yield blocks, and before them the oil's temperature each second, the speed and the changed command."""
    oil, speed = record.columns.get(OIL_TEMPERATURE), record.columns.get(SPEED)
    command, commanded = record.columns.get(COMMAND), math.nan
    due = next_speed = -1
    for first, block in blocks_of(record, start, block_duration):
        if oil is not None and block.stamp >= due and math.isfinite(oil[first]):
            yield cdr.OilTemperature(block.stamp, float(oil[first]))
            due = block.stamp + TEMPERATURE_INTERVAL
        if speed is not None and block.stamp >= next_speed and math.isfinite(speed[first]):
            yield cdr.Speed(block.stamp, float(speed[first]))
            next_speed = block.stamp + SPEED_INTERVAL
        if command is not None:
            part = command[first : first + block.body.size]
            for place in np.flatnonzero(np.isfinite(part) & (part != np.append(commanded, part[:-1]))):
                yield cdr.Command(block.stamp + round(int(place) * record.period * 1e9), float(part[place]))
            commanded = float(part[-1])
        yield block
