"""Parquet and Feather: columns by name, units from their metadata; read back what `export` writes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pa_compute
import pyarrow.ipc as pa_ipc
import pyarrow.parquet as pa_parquet
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.settings import Settings, StatedRate
from spool_bag.importing.table import STAMP, Channel, Group, GrowingColumns, Table, Values
from spool_bag.importing.units import split_header

#: Column that says which valve a row is of, in exports of several.
VALVE = "valve"
#: Rows of a batch: a page or two of a column at a time.
_BATCH = 1 << 16
_NUMERIC = (pa.types.is_floating, pa.types.is_integer, pa.types.is_decimal, pa.types.is_duration)
_IN_LISTS = "several values in a row: write one sample a row, e.g. with DataFrame.explode of pandas"
#: s of a unit of a duration.
_TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class ArrowTable(Table):
    """Parquet or Feather file, read in batches."""

    def __init__(self, path: Path) -> None:
        self.path = path
        if _is_parquet(path):
            schema = pa_parquet.ParquetFile(path).schema_arrow
        else:
            with pa.memory_map(str(path)) as source:
                schema = pa_ipc.open_file(source).schema
        known = self.settings = Settings(_stated(schema))
        channels = tuple(
            Channel(
                field.name,
                STAMP if dated else _unit(field, known),
                time=dated,
                number=number,
                scaling=known.scaling(field.name, whole=pa.types.is_integer(field.type)),
            )
            for number, field in enumerate(schema)
            for dated in [pa.types.is_timestamp(field.type) or pa.types.is_time(field.type)]
            if dated or any(is_one(field.type) for is_one in _NUMERIC)
        )
        self.unread = {
            field.name: _IN_LISTS if pa.types.is_nested(field.type) else "text"
            for field in schema
            if field.name not in {one.name for one in channels} | {VALVE}
        }
        valves = self._valves() if VALVE in schema.names else [""]
        rates = {rate.rate: rate for one in channels if (rate := known.rate(one.name)).source or rate.doubt}
        rate = next(iter(rates.values())) if len(rates) == 1 else StatedRate()
        first = channels[0].name if channels else ""
        self.groups = tuple(Group.stated(valve, channels, known, rate, first) for valve in valves)

    def read(self, group: Group, names: Sequence[str], single: Sequence[str] = ()) -> dict[str, Values]:
        """Return the values of columns by name."""
        columns = GrowingColumns(self.path, names, single)
        for batch in self._batches([*names, *([VALVE] if group.name else [])]):
            table = batch
            if group.name:
                call: Any = pa_compute
                table = batch.filter(call.equal(batch.column(VALVE), group.name))
            columns.add({name: _numbers(table.column(name)) for name in names})
            self.zoned = any(getattr(table.schema.field(name).type, "tz", None) for name in names)
        return columns.take()

    def where(self, row: int) -> str:
        """Return the row of a row."""
        return f"row {row}"

    def _batches(self, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        wanted = list(dict.fromkeys(names))
        if _is_parquet(self.path):
            file = pa_parquet.ParquetFile(self.path, pre_buffer=False)
            yield from file.iter_batches(_BATCH, columns=wanted)
            return
        with pa.memory_map(str(self.path)) as source:
            reader = pa_ipc.open_file(source)
            for at in range(reader.num_record_batches):
                yield reader.get_batch(at).select(wanted)

    def _valves(self) -> list[str]:
        """Return the valves in a file, in the order in which they come."""
        found: dict[str, None] = {}
        for batch in self._batches([VALVE]):
            found |= dict.fromkeys(str(name) for name in pa_compute.unique(batch.column(0)).to_pylist())
            if len(found) > 1000:
                raise InputError(
                    f"{self.path}: its column {VALVE} has more than 1000 values: name one valve a file"
                )
        return list(found) if len(found) > 1 else [""]


def _numbers(column: Any) -> Any:
    """Return a column as numbers: moments and times of day in ns, durations in s.

    Raises:
        InputError: a moment is missing.
    """
    kind = column.type
    if (pa.types.is_timestamp(kind) or pa.types.is_time(kind)) and column.null_count:
        raise InputError(f"{column.null_count} times are missing: leave out the rows without a time")
    if pa.types.is_time(kind):
        return column.cast(pa.time64("ns")).cast(pa.int64()).to_numpy(zero_copy_only=False)
    if pa.types.is_duration(kind):
        return column.cast(pa.int64()).cast(pa.float64()).to_numpy(zero_copy_only=False) * _TICKS[kind.unit]
    if pa.types.is_decimal(kind):
        return column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    if pa.types.is_timestamp(kind):
        return column.cast(pa.timestamp("ns", kind.tz)).cast(pa.int64()).to_numpy(zero_copy_only=False)
    values = column.to_numpy(zero_copy_only=False)
    return values if values.dtype.kind == "f" else values.astype(np.float64)


def _unit(field: pa.Field, known: Settings) -> str:
    if pa.types.is_duration(field.type):
        return "s"
    return known.unit(field.name) or split_header(printable(field.name, 200))[1]


def _stated(schema: pa.Schema) -> dict[str, str]:
    """Return the metadata of a file and of its columns by path."""
    held = {"": schema.metadata, **{f"{field.name}/": field.metadata for field in schema}}
    return {
        f"{at}{key.decode('utf-8', 'replace')}": value.decode("utf-8", "replace")
        for at, metadata in held.items()
        for key, value in (metadata or {}).items()
        if not key.startswith((b"PARQUET:", b"ARROW:"))
    }


def _is_parquet(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(4) == b"PAR1"


FORMAT = Format(
    "Parquet, Feather", (".parquet", ".pq", ".feather", ".arrow"), ArrowTable, begins=(b"PAR1", b"ARROW1")
)
