"""Tables of a store: their columns, and the Parquet files that are made of the manifest.

The same records give the same bytes: rows stand in the order of machine, valve, start and path, and nothing
of the run goes into a file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from spool_core.system import staged

from spool_fleet.manifest import Entry, Manifest, Outcome

FOLDER = "tables"
#: deg C to which viscous coefficients of different records are referred: that of ISO 3448's grades.
REFERENCE = 40.0
REFERRED = "viscous_coefficient_at_40C"
#: Records whose rows are written together: enough for columns that compress, few enough for any memory.
TOGETHER = 1000

#: The analysis that rows of a table come from, where they do not name it.
_SOURCES = {"events": "monitor", "gaps": "gap"}

_RECORD = (("bag", "text"), ("machine", "text"), ("valve", "text"), ("start", "time"))
_KINDS = {"text": pa.string(), "number": pa.float64(), "count": pa.int64(), "time": pa.timestamp("us", "UTC")}


def _schema(*columns: tuple[str, str], record: Sequence[tuple[str, str]] = _RECORD) -> pa.Schema:
    return pa.schema([(name, _KINDS[kind]) for name, kind in (*record, *columns)])


#: Tables of one row or more for each record, by name; each month has a file of each.
RECORD_TABLES = {
    "bags": _schema(
        ("duration_s", "number"), ("rate_Hz", "number"), ("lost_blocks", "count"), ("status", "text"),
        ("reason", "text"), ("oil_temperature_C", "number"), ("content", "text"),
    ),
    "analyses": _schema(("analysis", "text"), ("status", "text"), ("reason", "text")),
    "parameters": _schema(
        ("analysis", "text"), ("model", "text"), ("name", "text"), ("value", "number"), ("std", "number"),
        ("unit", "text"),
    ),
    "events": _schema(
        ("t_s", "number"), ("kind", "text"), ("state", "text"), ("severity", "text"), ("cause", "text"),
        ("value", "number"), ("unit", "text"), ("message", "text"),
    ),
    "gaps": _schema(
        ("verdict", "text"), ("confidence", "number"), ("nrmse_before", "number"), ("nrmse_after", "number"),
    ),
}  # fmt: skip

#: Trends of each valve's parameters over all bags; one file.
TRENDS = _schema(
    ("machine", "text"), ("valve", "text"), ("parameter", "text"), ("unit", "text"), ("bags", "count"),
    ("first", "time"), ("latest", "time"), ("baseline", "number"), ("baseline_std", "number"),
    ("state", "text"), ("cause", "text"), ("since", "time"), ("noticed", "time"), ("change", "number"),
    ("change_std", "number"), ("rate_per_month", "number"), ("rate_per_month_std", "number"),
    ("threshold", "number"), ("months_to_threshold", "number"), ("months_earliest", "number"),
    ("months_latest", "number"), ("reason", "text"), record=(),
)  # fmt: skip
#: Service events that were told; one file.
SERVICES = _schema(
    ("machine", "text"), ("valve", "text"), ("start", "time"), ("kind", "text"), ("comment", "text"),
    record=(),
)  # fmt: skip
SCHEMAS = {**RECORD_TABLES, "trends": TRENDS, "services": SERVICES}


def table_file(store: Path, table: str, part: str) -> Path:
    """Return the file of ``table`` for ``part``, a month or ``all``."""
    return store / FOLDER / table / f"{part}.parquet"


def bring_up_to_date(manifest: Manifest) -> None:
    """Write the tables of every month that lacks something or of which a file was removed."""
    removed = {
        month
        for month in manifest.months()
        if not all(table_file(manifest.store, table, month).exists() for table in RECORD_TABLES)
    }
    for month in sorted({*manifest.outdated(), *removed}):
        # Nobody may add to the month between what is written and the note that it is.
        with manifest.transaction():
            entries = list(manifest.entries(month))
            with ExitStack() as stack:
                writers = {
                    table: stack.enter_context(_writer(manifest.store, table, month))
                    for table in RECORD_TABLES
                }
                for first in range(0, len(entries), TOGETHER):
                    some = entries[first : first + TOGETHER]
                    found = [(entry, manifest.results(entry.path, entry.namespace)) for entry in some]
                    for table, writer in writers.items():
                        rows = [row for entry, results in found for row in _rows(table, entry, results)]
                        columns = zip(*rows, strict=True)
                        arrays = [
                            pa.array(one, kind)
                            for one, kind in zip(columns, writer.schema.types, strict=False)
                        ]
                        if rows:
                            writer.write_table(pa.Table.from_arrays(arrays, schema=writer.schema))
            for table in () if entries else RECORD_TABLES:
                table_file(manifest.store, table, month).unlink()
            manifest.written(month)


def write_whole(store: Path, table: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``table`` as one file with ``rows``."""
    with _writer(store, table, "all") as writer:
        writer.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema=SCHEMAS[table]))


def rows_in_tables(store: Path, month: str) -> dict[tuple[str, str, str], dict[str, list[list[Any]]]] | None:
    """Return the rows of ``month`` by bag, valve and analysis, each by table; ``None``: a file is lost."""
    found: dict[tuple[str, str, str], dict[str, list[list[Any]]]] = {}
    for table in ("parameters", *_SOURCES):
        try:
            rows = pq.read_table(table_file(store, table, month)).to_pylist()
        except (OSError, pa.ArrowInvalid):
            return None
        for row in rows:
            whose = row["bag"], row["valve"], _SOURCES.get(table) or row["analysis"]
            found.setdefault(whose, {}).setdefault(table, []).append(list(row.values())[len(_RECORD) :])
    return found


@contextmanager
def _writer(store: Path, table: str, part: str) -> Iterator[pq.ParquetWriter]:
    """Yield what writes the file of ``table`` for ``part``, which is replaced as a whole at the end."""
    file = table_file(store, table, part)
    file.parent.mkdir(parents=True, exist_ok=True)
    with staged(file) as staging, pq.ParquetWriter(staging, SCHEMAS[table], compression="zstd") as writer:
        yield writer


def _rows(table: str, entry: Entry, results: Sequence[Outcome]) -> list[list[Any]]:
    """Return the rows of ``entry`` in ``table``, in the order of the analyses."""
    record = [entry.path, entry.machine, entry.valve, entry.start // 1000]
    if table == "bags":
        return [[*record, entry.duration, entry.rate, entry.lost, entry.status, entry.reason or None,
                 entry.temperature, entry.content]]  # fmt: skip
    if table == "analyses":
        return [[*record, one.analysis, one.status, one.reason or None] for one in results]
    return [[*record, *row] for one in results for row in one.rows.get(table, [])]
