"""MATLAB's files up to version 7: arrays, fields of structures, cells, tables and timetables by name."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from spool_core.errors import InputError
from spool_core.text import printable

from spool_bag.importing.formats.format import Format
from spool_bag.importing.table import ArrayTable, array_table, check_size

#: Structures within structures that are looked into, and elements of a structure or cell array.
DEEPEST, MOST_ELEMENTS = 4, 1000


def opened(path: Path) -> ArrayTable:
    """Return the arrays of a file; what is no number is left out."""
    from scipy.io import loadmat  # noqa: PLC0415 - 30 MB that others do not need

    check_size(path)
    held = loadmat(path, squeeze_me=True, struct_as_record=False)
    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    texts: dict[str, str] = {}
    for name, value in held.items():
        if not name.startswith("__"):
            _collect(name, value, arrays, texts, DEEPEST)
    if "__function_workspace__" in held or any(isinstance(value, _opaque()) for value in held.values()):
        tables, units = tables_of(path)
        arrays |= tables
    return array_table(path, arrays, units, texts)


def tables_of(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the columns of a file's tables and timetables, of any version of MATLAB, and their units.

    Raises:
        InputError: the library for them is not there.
    """
    try:
        from matio import load_from_mat  # noqa: PLC0415 - 0.5 s, for tables alone
    except ImportError:
        raise InputError(
            f"{path}: it holds a table or timetable of MATLAB, which needs the package mat-io and Python "
            f"3.11: "
            "write its columns as arrays: s = table2struct(timetable2table(T), 'ToScalar', true); "
            "save('record.mat', '-struct', 's')"
        ) from None
    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name, frame in load_from_mat(path, add_table_attrs=True).items():
        if hasattr(frame, "columns") and hasattr(frame, "index"):
            _take_frame(name, frame, arrays, units)
    return arrays, units


def _take_frame(name: str, frame: Any, arrays: dict[str, Any], units: dict[str, str]) -> None:
    times = np.asarray(frame.index)
    if times.dtype.kind in "mM":
        arrays[f"{name}/Time"] = seconds_of(times)
        units |= {f"{name}/Time": "s"} if times.dtype.kind == "m" else {}
    stated = np.ravel(np.asarray(frame.attrs.get("varUnits", ()), dtype=object)).tolist()
    for at, column in enumerate(frame.columns):
        values = np.asarray(frame[column])
        if values.dtype.kind in "fiubmM":
            arrays[f"{name}/{column}"] = seconds_of(values)
            if values.dtype.kind == "m":
                units[f"{name}/{column}"] = "s"
            elif len(stated) == len(frame.columns) and str(stated[at]):
                units[f"{name}/{column}"] = str(stated[at])


def seconds_of(values: Any) -> Any:
    """Return durations as s; other values as they are."""
    if values.dtype.kind != "m":
        return values
    return values.astype("timedelta64[ns]").astype(np.int64) * 1e-9


def _opaque() -> Any:
    from scipy.io.matlab import MatlabOpaque  # noqa: PLC0415

    return MatlabOpaque


def _collect(name: str, value: Any, arrays: dict[str, Any], texts: dict[str, str], deeper: int) -> None:
    fields = getattr(value, "_fieldnames", None)
    if isinstance(value, str):
        texts[name] = value
    elif fields is None:
        array = np.asarray(value)
        if array.dtype.kind in "fiub":
            arrays[name] = array
        elif array.dtype == object and array.ndim and deeper > 0 and not isinstance(value, _opaque()):
            for at, entry in enumerate(array.ravel()[:MOST_ELEMENTS]):
                _collect(f"{name}({at + 1})", entry, arrays, texts, deeper - 1)
    elif deeper > 0:
        for field in fields:
            entry = getattr(value, field)
            _collect(f"{name}/{printable(field, 60)}", entry, arrays, texts, deeper - 1)


def _is_version_4(path: Path, head: bytes) -> bool:
    """Return whether a file begins with the header of a matrix of version 4, which has no fixed bytes."""
    if path.suffix.lower() != ".mat" or len(head) < 22:
        return False
    for order in "<>":
        kind, rows, columns, imaginary, size = struct.unpack(f"{order}5i", head[:20])
        digits = f"{kind:04d}" if 0 <= kind < 10_000 else ""
        name = head[20 : 20 + size]
        if (
            digits
            and digits[1] == "0"
            and digits[2] in "012345"
            and digits[3] in "012"
            and min(rows, columns) >= 0
            and imaginary in (0, 1)
            and 2 <= size <= len(head) - 20
            and name.endswith(b"\0")
            and name[:-1].replace(b"_", b"a").isalnum()
        ):
            return True
    return False


FORMAT = Format("MATLAB", (".mat",), opened, begins=(b"MATLAB 5.0",), recognises=_is_version_4)
