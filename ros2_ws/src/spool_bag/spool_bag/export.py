"""Export of a bag as a table: Parquet or CSV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from spool_core.block import Block
from spool_core.block_gate import BlockGate, Verdict
from spool_core.cdr import Command, OilTemperature, Speed
from spool_core.errors import InputError
from spool_core.system import staged
from spool_core.text import plural, printable

from spool_bag import BODY, COMMAND, OIL_TEMPERATURE, SPEED, SPOOL, TIME
from spool_bag.blocks import Span
from spool_bag.information import Timeline, step_text
from spool_bag.reader import BagReader

VALVE = "valve"
BATCH_ROWS = 1 << 16


@dataclass(frozen=True, slots=True)
class ExportResult:
    """Result of an export; ``refused_blocks`` are malformed and left out, ``warnings`` a line each."""

    file: Path
    valves: tuple[str, ...]
    rows: int
    refused_blocks: int
    warnings: tuple[str, ...] = ()


def export_bag(
    bag: Path | str,
    out: Path | str,
    *,
    valves: Sequence[str] | None = None,
    span: Span | None = None,
    progress: Callable[[int], None] | None = None,
) -> ExportResult:
    """Write the samples of ``bag`` to ``out`` (.parquet, .csv or .csv.gz), one row per sample.

    Columns are the contract's: ``time_s`` from the bag's first stamp, float32 accelerations, oil
    temperature and speed where they are recorded (the last one known, empty before the first), and ``valve``
    where there are several; their rows follow one another. Where a clock was set, time is counted on.
    ``progress`` gets the number of rows of each batch. Of ``span`` only what lies in it.

    Raises:
        InputError: the bag, a valve or the target's name cannot be used.
    """
    out = Path(out)
    reader = BagReader(bag, span=span or Span())
    chosen = tuple(valves or reader.valves)
    if not chosen:
        raise InputError(
            f"{bag}: no acceleration topic in it, so there is nothing to export; it has {reader.listed}"
        )
    if out.exists() or out.is_symlink():
        raise InputError(f"{out} exists already: name a file that does not, or remove it")
    starts: list[int] = []
    for valve in chosen:
        gate = BlockGate()
        usable = (one.stamp for one in reader.blocks(valve) if gate.judge(one) is not Verdict.REFUSED)
        starts += islice(usable, 1)
    if not starts:
        raise InputError(f"{bag}: no usable block in it, so there is nothing to export")
    fields = [(TIME, pa.float64()), (BODY, pa.float32()), (SPOOL, pa.float32())]
    fields += [
        (column, pa.float64())
        for column, topic in ((OIL_TEMPERATURE, "oil_temperature"), (SPEED, "speed"), (COMMAND, "command"))
        if any(f"/{valve}/{topic}" in reader.topics for valve in chosen)
    ]
    schema = pa.schema([(VALVE, pa.string()), *fields] if len(chosen) > 1 else fields)
    rows = 0
    sources = {valve: _ValveTable(min(starts), _cell(out, valve)) for valve in chosen}
    try:
        kind = _kind(out)
        with staged(out) as part, _writer(kind, part, schema) as writer:
            for valve, source in sources.items():
                for batch in _batches(reader, valve, source, schema):
                    writer.write_batch(batch)
                    rows += batch.num_rows
                    if progress is not None:
                        progress(batch.num_rows)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror or error}") from error
    warnings = [*reader.warnings]
    for valve, source in sources.items():
        warnings += [step_text(valve, step) for step in source.timeline.steps]
    warnings += [
        f"{topic}: {plural(count, 'message')} left out: the bytes do not fit the type"
        for topic, count in reader.undecodable.items()
    ]
    refused = sum(source.gate.refused for source in sources.values())
    return ExportResult(out, chosen, rows, refused, tuple(warnings))


@dataclass(slots=True)
class _ValveTable:
    """Table of one valve: the bag's first stamp (ns), the name as a cell, judgements of its blocks."""

    start: int
    cell: str
    gate: BlockGate = field(default_factory=BlockGate)
    timeline: Timeline = field(default_factory=Timeline)

    def usable(self, block: Block) -> bool:
        """Take a block; return whether its samples are to be written."""
        self.timeline.take(block)
        return self.gate.judge(block) is not Verdict.REFUSED

    def since(self, block: Block) -> int:
        """Return the time (ns) of the last block taken, across the steps of a clock that was set."""
        spans = self.timeline.spans
        return spans[-1].before + block.stamp - spans[-1].first + spans[0].first - self.start


def _cell(out: Path, valve: str) -> str:
    """Return a valve's name as a cell: in a CSV file nothing that a spreadsheet takes for a formula."""
    if _kind(out) == ".parquet":
        return valve
    cell = printable(valve).translate(str.maketrans(',;"', "___"))
    return "'" + cell if cell[:1] in tuple("=+-@") else cell


def _kind(out: Path) -> str:
    kind = "".join(out.suffixes[-2:]) if out.suffix == ".gz" else out.suffix
    if kind not in (".parquet", ".csv", ".csv.gz"):
        raise InputError(f"{out}: ends in {out.suffix or 'nothing'}: give a .parquet, .csv or .csv.gz file")
    return kind


@contextmanager
def _writer(kind: str, part: Path, schema: pa.Schema) -> Iterator[Any]:
    """Give what writes batches of rows to the file ``part``, which is closed at the end."""
    part.parent.mkdir(parents=True, exist_ok=True)
    if kind == ".parquet":
        with pa_parquet.ParquetWriter(part, schema, compression="zstd") as table:
            yield table
        return
    options = pa_csv.WriteOptions(include_header=False, quoting_style="none")
    with pa.output_stream(str(part), compression="gzip" if kind == ".csv.gz" else None) as sink:
        sink.write((",".join(schema.names) + "\n").encode())
        with pa_csv.CSVWriter(sink, schema, write_options=options) as rows:
            yield rows


def _batches(
    reader: BagReader, valve: str, source: _ValveTable, schema: pa.Schema
) -> Iterator[pa.RecordBatch]:
    blocks: list[tuple[int, Block]] = []
    readings: dict[str, list[float]] = {OIL_TEMPERATURE: [], SPEED: [], COMMAND: []}
    newest, rows = dict.fromkeys(readings, float("nan")), 0
    for item in reader.stream(valve):
        if isinstance(item, OilTemperature):
            newest[OIL_TEMPERATURE] = item.celsius
        elif isinstance(item, Speed):
            newest[SPEED] = item.rpm
        elif isinstance(item, Command):
            newest[COMMAND] = item.value
        elif source.usable(item):
            blocks.append((source.since(item), item))
            for column, value in newest.items():
                readings[column].append(value)
            rows += item.body.size
            if rows >= BATCH_ROWS:
                yield _batch(source.cell, schema, blocks, readings)
                blocks, readings, rows = [], {column: [] for column in readings}, 0
    if blocks:
        yield _batch(source.cell, schema, blocks, readings)


def _batch(
    valve: str, schema: pa.Schema, timed: list[tuple[int, Block]], readings: dict[str, list[float]]
) -> pa.RecordBatch:
    # Whole nanoseconds divided once: the printed time is the shortest that names the stamp.
    blocks = [block for _, block in timed]
    stamps = [
        first + np.rint(np.arange(block.body.size) * (block.sample_period * 1e9)) for first, block in timed
    ]
    columns = {
        TIME: pa.array(np.concatenate(stamps) / 1e9),
        BODY: pa.array(np.concatenate([block.body for block in blocks])),
        SPOOL: pa.array(np.concatenate([block.spool for block in blocks])),
    }
    sizes = [block.body.size for block in blocks]
    if VALVE in schema.names:
        columns[VALVE] = pa.array([valve] * sum(sizes))
    for column in set(readings).intersection(schema.names):
        columns[column] = pa.array(np.repeat(readings[column], sizes), from_pandas=True)
    return pa.record_batch([columns[name] for name in schema.names], schema=schema)
