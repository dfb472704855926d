"""Query over the tables of a fleet store: SQL by DuckDB, which reads them and nothing else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
from spool_stream.errors import InputError

from .parquet import FOLDER
from .schema import SCHEMAS


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
            raise InputError("query: one SELECT is answered, nothing else")
        return connection.sql(sql).to_arrow_table()
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
        raise InputError(f"{store}: no tables in it: ./spool fleet run --store {store} makes them")
    connection = duckdb.connect(":memory:")
    connection.execute("SET TimeZone = 'UTC'")
    for name, schema in SCHEMAS.items():
        files = sorted((folder / name).glob("[!.]*.parquet"))
        if files:
            listed = ", ".join(_quoted(str(file)) for file in files)
            connection.execute(f"CREATE VIEW {name} AS SELECT * FROM read_parquet([{listed}])")
        else:
            columns = ", ".join(f"NULL::{_KINDS[str(one.type)]} AS {one.name}" for one in schema)
            connection.execute(f"CREATE VIEW {name} AS SELECT {columns} WHERE false")
    connection.execute(f"SET allowed_directories = [{_quoted(str(folder) + '/')}]")
    connection.execute("SET enable_external_access = false")
    connection.execute("SET lock_configuration = true")
    return connection


def rows_of(table: pa.Table) -> list[dict[str, Any]]:
    """Return the rows of ``table`` as JSON takes them; times in ISO 8601."""
    return [
        {name: value.isoformat() if hasattr(value, "isoformat") else value for name, value in row.items()}
        for row in table.to_pylist()
    ]


_KINDS = {
    "string": "VARCHAR", "double": "DOUBLE", "int64": "BIGINT", "timestamp[us, tz=UTC]": "TIMESTAMPTZ",
}  # fmt: skip


def _quoted(text: str) -> str:
    return "'" + re.sub("'", "''", text) + "'"
