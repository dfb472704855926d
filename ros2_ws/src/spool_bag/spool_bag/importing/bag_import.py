"""Import: the files of data loggers as a bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from spool_core.cdr import OilTemperature, encode_block, encode_temperature
from spool_core.text import printable

from spool_bag.format.definitions import ACCELERATION_BLOCK, TEMPERATURE
from spool_bag.format.metadata import RATE_STD
from spool_bag.format.metadata import custom_data as kept_data
from spool_bag.names import check_valve
from spool_bag.recording.writer import BagWriter
from spool_bag.tables.column_names import OIL_TEMPERATURE

from .records.blocks import BLOCK_DURATION, blocks_of, checked_start, stream_of
from .records.choices import Choices
from .records.clocks import ClockOffset
from .records.logger_record import LoggerRecord, read_record


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
    with BagWriter(out, staged=True, custom=custom_data(record)) as writer:
        channel = writer.add_topic(f"/{valve}/acceleration", ACCELERATION_BLOCK)
        thermal = OIL_TEMPERATURE in record.columns
        oil = writer.add_topic(f"/{valve}/oil_temperature", TEMPERATURE) if thermal else 0
        for item in stream_of(record, begin, block_duration):
            if isinstance(item, OilTemperature):
                writer.write(oil, item.stamp, encode_temperature(item, valve))
                temperatures += 1
                continue
            writer.write(channel, item.stamp, encode_block(item, valve), sequence=item.sequence & 0xFFFFFFFF)
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


#: Begin of the keys of ``custom_data`` that hold columns and their conversions.
_COLUMN = "import_column_"


def import_notes(bag: Path) -> tuple[str, ...]:
    """Return from which columns a bag was imported, and how they were converted; empty for a recorded bag."""
    held = kept_data(bag)
    uses = [text for key, text in held.items() if key.startswith(_COLUMN)]
    return (f"imported from {printable(held.get('imported_from', ''), 80)}", *uses) if uses else ()


def custom_data(record: LoggerRecord) -> dict[str, str]:
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
