"""Fleet: many bags of many valves, as tables and trends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyarrow as pa


def table(store: Path | str, query: str) -> pa.Table:
    """Return a table of the fleet store, or what an SQL query finds in it.

    Args:
        store: folder of the fleet.
        query: a table's name (``bags``, ``parameters``, ...) or SQL, e.g. ``SELECT * FROM trends``.

    Raises:
        InputError: no such store, or the query is no SQL that can be answered.
    """
    from spool_fleet.query import ask  # noqa: PLC0415 - DuckDB takes a moment to load

    return ask(Path(store), query)
