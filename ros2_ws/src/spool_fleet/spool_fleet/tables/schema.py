"""Schemas of the tables of a fleet store."""

from __future__ import annotations

import pyarrow as pa

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
