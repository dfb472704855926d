"""Questions to the tables in SQL, and those that the commands ask."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from datetime import timedelta
from decimal import Decimal
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
from spool_core.errors import InputError
from spool_core.text import did_you_mean

from spool_fleet.parquet import FOLDER, SCHEMAS

#: A bit string becomes bytes with a filling, a time of day loses its zone.
_LOST_IN_ARROW = re.compile(r"\b(?:BIT|TIME WITH TIME ZONE)\b")

_WHOSE = "({machine} = '' OR machine = {machine}) AND ({valve} = '' OR valve = {valve})"


@dataclass(frozen=True, slots=True)
class Question:
    """``sql`` with ``{machine}``, ``{valve}``, ``{parameter}`` as quoted texts; empty: all."""

    line: str
    sql: str


QUESTIONS = {
    "trend": Question(
        "one parameter of a valve from bag to bag",
        "SELECT start, machine, valve, analysis, value, std, unit FROM parameters "
        f"WHERE name = {{parameter}} AND {_WHOSE} ORDER BY machine, valve, start",
    ),
    "worst": Question(
        "valves that changed most, in shares of the monitor's limit",
        "SELECT machine, valve, parameter, state, cause, change, change_std, since, months_to_threshold, "
        "abs(change / threshold) AS share_of_limit FROM trends WHERE state IN ('changed', 'machine_wide') "
        f"AND {_WHOSE} ORDER BY share_of_limit DESC NULLS LAST",
    ),
    "changed": Question(
        "changes since the last service of each valve",
        "SELECT t.machine, t.valve, t.parameter, t.state, t.cause, t.change, t.change_std, t.since, "
        "max(s.start) AS last_service FROM trends t LEFT JOIN services s ON s.machine IN ('', t.machine) "
        "AND s.valve IN ('', t.valve) WHERE t.state IN ('changed', 'machine_wide') "
        "AND ({machine} = '' OR t.machine = {machine}) AND ({valve} = '' OR t.valve = {valve}) "
        "GROUP BY ALL HAVING last_service IS NULL OR t.since >= last_service ORDER BY t.machine, t.valve",
    ),
    "springs": Question(
        "natural frequency and stiffness of each valve: which spring set is in it",
        "SELECT machine, valve, median(value) FILTER (name = 'natural_frequency') AS natural_frequency_Hz, "
        "median(value) FILTER (name = 'spring_stiffness') AS spring_stiffness_N_m, "
        "count(DISTINCT bag) AS bags "
        f"FROM parameters WHERE {_WHOSE} GROUP BY ALL ORDER BY natural_frequency_Hz",
    ),
    "oil-change": Question(
        "one parameter before and after each oil change, medians of 60 days",
        "SELECT s.machine, p.valve, s.start AS oil_change, "
        "median(p.value) FILTER (p.start < s.start) AS before, "
        "median(p.value) FILTER (p.start >= s.start) AS after, any_value(p.unit) AS unit "
        "FROM services s JOIN parameters p ON s.machine IN ('', p.machine) AND s.valve IN ('', p.valve) "
        "WHERE s.kind = 'oil_change' AND p.name = {parameter} "
        "AND p.start BETWEEN s.start - INTERVAL 60 DAY AND s.start + INTERVAL 60 DAY "
        "AND ({machine} = '' OR p.machine = {machine}) AND ({valve} = '' OR p.valve = {valve}) "
        "GROUP BY ALL ORDER BY s.start, p.valve",
    ),
    "damaged": Question(
        "bags that are damaged or there twice, and analyses that failed",
        "SELECT bag, machine, valve, status AS what, reason FROM bags WHERE status <> 'ok' UNION ALL "
        "SELECT bag, machine, valve, analysis || ' failed', reason FROM analyses WHERE status <> 'ok' "
        "ORDER BY bag",
    ),
}


def ask(store: Path, query: str) -> pa.Table:
    """Return what ``query``, SQL or a table's name, finds in ``store``.

    Raises:
        InputError: no such store, or the query cannot be answered; DuckDB's first line says why.
    """
    connection = connect(store)
    sql = f"SELECT * FROM {query}" if query in SCHEMAS else query
    try:
        statements = connection.extract_statements(sql)
        if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
            raise InputError("query: only a single SELECT is allowed")
        return _without_bits(connection.sql(sql)).to_arrow_table()
    except duckdb.Error as error:
        tables = ", ".join(SCHEMAS)
        text = " ".join(str(error).split("\n")[0].split())
        raise InputError(f"query: {text}; tables are {tables}") from None
    finally:
        connection.close()


def connect(store: Path) -> duckdb.DuckDBPyConnection:
    """Return a connection in which each table of ``store`` is a view; it can read no other file.

    Raises:
        InputError: there are no tables in ``store``.
    """
    folder = (store / FOLDER).absolute()
    if not folder.is_dir():
        raise InputError(f"{store}: no tables yet: create them with ./spool fleet run --store {store}")
    connection = duckdb.connect(":memory:")
    connection.execute("SET TimeZone = 'UTC'")
    for name, schema in SCHEMAS.items():
        files = sorted((folder / name).glob("[!.]*.parquet"))
        if files:
            listed = ", ".join(_quoted(str(file)) for file in files)
            connection.execute(f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{listed}])")
        else:
            connection.register(name, schema.empty_table())
    connection.execute(f"SET allowed_directories = [{_quoted(str(folder) + '/')}]")
    connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")
    return connection


def rows_of(table: pa.Table) -> list[dict[str, Any]]:
    """Return the rows of ``table`` as JSON takes them; columns of one name get numbers.

    Decimals and intervals (s) are numbers, times and intervals of months ISO 8601, bytes hexadecimal, maps
    objects. A time beyond the calendar, as infinity, is null.
    """
    names = list(table.column_names)
    names = [
        f"{name}_{names[:place].count(name) + 1}" if name in names[:place] else name
        for place, name in enumerate(names)
    ]
    columns = [[_plain(_value(scalar), column.type) for scalar in column] for column in table.columns]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def sql_of(name: str, machine: str, valve: str, parameter: str) -> str:
    """Return the SELECT of the question ``name``.

    Raises:
        InputError: there is no such question; those there are are listed.
    """
    if name not in QUESTIONS:
        listed = "; ".join(f"{key}: {question.line}" for key, question in QUESTIONS.items())
        near = did_you_mean(name, list(QUESTIONS))
        raise InputError(f"--question {name}: known are {listed}{near}")
    return QUESTIONS[name].sql.format(
        machine=_quoted(machine), valve=_quoted(valve), parameter=_quoted(parameter)
    )


def _without_bits(found: duckdb.DuckDBPyRelation) -> duckdb.DuckDBPyRelation:
    """Return ``found`` with text in place of the types that lose their meaning in Arrow."""
    wanted = [_LOST_IN_ARROW.sub("VARCHAR", str(kind)) for kind in found.types]
    if wanted == [str(kind) for kind in found.types]:
        return found
    columns = (
        f'CAST(#{number} AS {kind}) AS "{name.replace(chr(34), 2 * chr(34))}"'
        for number, (name, kind) in enumerate(zip(found.columns, wanted, strict=True), 1)
    )
    return found.project(", ".join(columns))


def _value(scalar: Any) -> Any:
    try:
        return scalar.as_py()
    except (OverflowError, ValueError):  # beyond the years of Python's calendar
        return None


def _plain(value: Any, kind: Any) -> Any:
    """Return a value of the Arrow type ``kind`` as JSON takes it."""
    if value is None:
        return None
    if pa.types.is_map(kind):
        pairs = ((_plain(key, kind.key_type), _plain(one, kind.item_type)) for key, one in value)
        return {key if isinstance(key, str) else json.dumps(key): one for key, one in pairs}
    if pa.types.is_struct(kind):
        return {field.name: _plain(value[field.name], field.type) for field in kind}
    if isinstance(value, list):
        return [_plain(one, kind.value_type) for one in value]
    if isinstance(value, pa.MonthDayNano):
        months, days, nanoseconds = value
        seconds = 86_400 * days + 1e-9 * nanoseconds
        return f"P{months}MT{seconds:.9g}S" if months else seconds
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() else float(value)
    if isinstance(value, timedelta):
        return value.total_seconds()
    if isinstance(value, bytes):
        return value.hex()
    if hasattr(value, "isoformat"):
        return value.isoformat()
    return value if isinstance(value, (bool, int, float, str)) else str(value)


def _quoted(text: str) -> str:
    return "'" + re.sub("'", "''", text) + "'"
