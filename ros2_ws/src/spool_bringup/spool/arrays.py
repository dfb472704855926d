"""Arrays and tables in memory as a file that is imported like any other."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spool_core.errors import InputError

#: Columns of an array without names, by their number.
_COLUMNS = {2: ("body", "spool"), 3: ("time", "body", "spool")}


def write_table(source: Any, file: Path, rate: float | None) -> None:
    """Write ``source`` (a mapping of arrays, an array, a pandas or Arrow table) as a Parquet file.

    Raises:
        InputError: it is none of these, lengths differ, or it holds what is no number and no time.
    """
    import pyarrow as pa  # noqa: PLC0415 - slow to load
    from pyarrow import parquet  # noqa: PLC0415

    try:
        table = _table(source, rate)
        parquet.write_table(table, file)
    except (pa.ArrowException, TypeError) as error:
        raise InputError(f"arrays: {' '.join(str(error).split())}: give numbers and times") from error


def _table(source: Any, rate: float | None) -> Any:
    import numpy as np  # noqa: PLC0415
    import pyarrow as pa  # noqa: PLC0415

    if isinstance(source, Mapping):
        named = {str(key): np.asarray(value) for key, value in source.items()}
    elif isinstance(source, np.ndarray):
        named = _named(source, rate)
    elif isinstance(source, pa.Table):
        return source
    elif hasattr(source, "columns") and hasattr(source, "index"):  # pandas
        kept = source.index.name is not None or str(source.index.dtype).startswith("datetime64")
        table = pa.Table.from_pandas(source, preserve_index=kept)
        return table.rename_columns(
            [{"__index_level_0__": "time"}.get(one, one) for one in table.column_names]
        )
    elif hasattr(source, "to_arrow"):  # polars
        return source.to_arrow()
    else:
        raise InputError(
            f"spool.read: {type(source).__name__} is no record: give a path, a pandas table, a mapping of "
            "arrays or an array"
        )
    flat = {key: row.ravel() if row.ndim == 2 and 1 in row.shape else row for key, row in named.items()}
    odd = next((key for key, row in flat.items() if row.ndim != 1), None)
    if odd is not None:
        raise InputError(f"arrays: {odd} has the shape {flat[odd].shape}: give one value for each sample")
    sizes = {key: row.size for key, row in flat.items()}
    if len(set(sizes.values())) > 1:
        said = ", ".join(f"{key} has {size}" for key, size in sizes.items())
        raise InputError(f"arrays: lengths differ: {said} values: give arrays of one length")
    return pa.table({key: pa.array(row) for key, row in flat.items()})


def _named(array: Any, rate: float | None) -> dict[str, Any]:
    """Return the columns of an array by name."""
    if array.dtype.names:
        return {name: array[name] for name in array.dtype.names}
    wanted = "give columns time, body and spool, or body and spool with rate=, or a mapping with names"
    if array.ndim != 2 or array.shape[1] not in _COLUMNS:
        turned = array.ndim == 2 and array.shape[0] in _COLUMNS
        hint = "; its rows are channels: pass array.T" if turned else ""
        raise InputError(f"spool.read: an array of the shape {array.shape}: {wanted}{hint}")
    if array.shape[1] == 2 and rate is None:
        raise InputError(f"spool.read: an array of two columns has no time: {wanted}")
    return {name: array[:, at] for at, name in enumerate(_COLUMNS[array.shape[1]])}
