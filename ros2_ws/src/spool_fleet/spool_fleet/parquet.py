"""Tables of a store: their columns, and the Parquet files that hold them.

The same records give the same bytes: rows stand in the order of machine, valve, start and path, and nothing
of the run goes into a file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from spool_core.system import staged

from spool_fleet.manifest import Entry, Manifest, StoredResult

FOLDER = "tables"

#: The analysis that rows of a table come from, where it is but one.
_SOURCES = {"events": "monitor", "gaps": "gap"}

_RECORD = [
    ("bag", pa.string()),
    ("machine", pa.string()),
    ("valve", pa.string()),
    ("start", pa.timestamp("us", "UTC")),
]


def _schema(*columns: tuple[str, str]) -> pa.Schema:
    kinds = {
        "text": pa.string(),
        "number": pa.float64(),
        "count": pa.int64(),
        "time": pa.timestamp("us", "UTC"),
    }
    return pa.schema([*_RECORD, *((name, kinds[kind]) for name, kind in columns)])


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
TRENDS = pa.schema(
    [
        ("machine", pa.string()), ("valve", pa.string()), ("parameter", pa.string()), ("unit", pa.string()),
        ("bags", pa.int64()), ("first", pa.timestamp("us", "UTC")), ("latest", pa.timestamp("us", "UTC")),
        ("baseline", pa.float64()), ("baseline_std", pa.float64()), ("state", pa.string()),
        ("cause", pa.string()), ("since", pa.timestamp("us", "UTC")), ("noticed", pa.timestamp("us", "UTC")),
        ("change", pa.float64()), ("change_std", pa.float64()), ("rate_per_month", pa.float64()),
        ("rate_per_month_std", pa.float64()), ("threshold", pa.float64()),
        ("months_to_threshold", pa.float64()), ("months_earliest", pa.float64()),
        ("months_latest", pa.float64()), ("reason", pa.string()),
    ]
)  # fmt: skip
#: Service events that were told; one file.
SERVICES = pa.schema(
    [
        ("machine", pa.string()), ("valve", pa.string()), ("start", pa.timestamp("us", "UTC")),
        ("kind", pa.string()), ("comment", pa.string()),
    ]
)  # fmt: skip
SCHEMAS = {**RECORD_TABLES, "trends": TRENDS, "services": SERVICES}


def table_file(store: Path, table: str, part: str) -> Path:
    """Return the file of ``table`` for ``part``, a month or ``all``."""
    return store / FOLDER / table / f"{part}.parquet"


def write_month(manifest: Manifest, month: str) -> None:
    """Bring the tables of ``month`` up to date with the manifest.

    Rows that the manifest does not hold any more come from the file that is there. Each file is replaced as
    a whole, and what waits in the manifest is dropped once all are.
    """
    store, entries = manifest.store, list(manifest.entries(month))
    for table in RECORD_TABLES:
        _write_table(manifest, table, month, entries)
    manifest.written(month)
    for table in RECORD_TABLES:
        file = table_file(store, table, month)
        if not entries:
            file.unlink(missing_ok=True)


def missing_months(manifest: Manifest) -> list[str]:
    """Return the months of which a table was removed."""
    return [
        month
        for month in manifest.months()
        if any(not table_file(manifest.store, table, month).exists() for table in RECORD_TABLES)
    ]


def write_whole(store: Path, table: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``table`` as one file with ``rows``."""
    content = pa.Table.from_pylist([dict(row) for row in rows], schema=SCHEMAS[table])
    _replace(table_file(store, table, "all"), table, iter([content]))


def _write_table(manifest: Manifest, table: str, month: str, entries: Sequence[Entry]) -> None:
    file = table_file(manifest.store, table, month)
    kept = _Kept(file) if file.exists() else None

    def groups() -> Iterator[pa.Table]:
        for entry in entries:
            rows = _rows(table, entry, manifest.results(entry.path, entry.namespace), kept)
            if rows:
                record = [entry.path, entry.machine, entry.valve, entry.start // 1000]
                schema = SCHEMAS[table]
                whole = [[*record, *row] for row in rows]
                columns = [
                    pa.array([row[number] for row in whole], schema.field(number).type)
                    for number in range(len(schema))
                ]
                yield pa.Table.from_arrays(columns, schema=schema)

    _replace(file, table, groups())


def _replace(file: Path, table: str, groups: Iterator[pa.Table]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    # Dictionaries of so few rows would cost more than they save; by statistics a query skips other valves.
    known = [name for name in ("machine", "valve", "start") if name in SCHEMAS[table].names]
    options = {"compression": "zstd", "use_dictionary": False, "write_statistics": known}
    with staged(file, replace=True) as part, pq.ParquetWriter(part, SCHEMAS[table], **options) as writer:
        for group in groups:
            writer.write_table(group)


class _Kept:
    """Rows of a file that is there, by record; a row group is read when it is asked for."""

    def __init__(self, file: Path) -> None:
        self._file = pq.ParquetFile(file)
        self._groups: dict[tuple[str, str], list[int]] = {}
        for number in range(self._file.num_row_groups):
            first = self._file.read_row_group(number, columns=["bag", "valve"]).slice(0, 1).to_pylist()
            for row in first:
                self._groups.setdefault((row["bag"], row["valve"]), []).append(number)

    def rows(self, entry: Entry) -> list[list[Any]]:
        """Return the rows of ``entry`` without the columns that say which record it is."""
        found: list[list[Any]] = []
        for number in self._groups.get((entry.path, entry.valve), ()):
            for row in self._file.read_row_group(number).to_pylist():
                found.append(list(row.values())[4:])
        return found


def _rows(table: str, entry: Entry, results: Sequence[StoredResult], kept: _Kept | None) -> list[list[Any]]:
    """Return the rows of ``entry`` in ``table``, in the order of the analyses."""
    if table == "bags":
        return [[entry.duration, entry.rate, entry.lost, entry.status, entry.reason or None,
                 entry.temperature, entry.content]]  # fmt: skip
    if table == "analyses":
        return [[one.analysis, one.status, one.reason or None] for one in results]
    known = {one.analysis for one in results if one.rows is None}
    old = kept.rows(entry) if kept is not None and known else []
    found = []
    for one in results:
        if one.rows is not None:
            found += one.rows.get(table, [])
        elif table == "parameters":
            found += [row for row in old if row[0] == one.analysis]
        elif one.analysis == _SOURCES[table]:
            found += old
    return found
