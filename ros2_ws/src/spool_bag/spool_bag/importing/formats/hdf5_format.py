"""HDF5 and MATLAB from version 7.3 on: datasets and columns of tables by path, units from attributes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spool_bag.importing.formats.format import Format
from spool_bag.importing.formats.matlab_format import DEEPEST, MOST_ELEMENTS, tables_of
from spool_bag.importing.table import MOST_CHANNELS, ArrayTable, array_table, check_size

#: Characters of a text that is a setting.
LONGEST_TEXT = 1000


def opened(path: Path) -> ArrayTable:
    """Return the datasets of a file, by their paths."""
    import h5py  # noqa: PLC0415 - comes with the extras

    arrays: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    size, tables = 0, False

    def elements(name: str, entry: Any, matlab: str) -> None:
        """Visit what the references of a cell array, or of a field of an array of structures, lead to."""
        parent, _, field = name.rpartition("/")
        if matlab != "cell" and _text(entry.parent.attrs.get("MATLAB_class", "")) != "struct":
            return  # other formats number dimensions so
        for at, reference in enumerate(np.ravel(entry[()])[:MOST_ELEMENTS], start=1):
            if not reference or name.count("(") >= DEEPEST:
                continue
            element = f"{name}({at})" if matlab == "cell" else f"{parent}({at})/{field}"
            held = entry.file[reference]
            visit(element, held)
            if isinstance(held, h5py.Group):
                for key, part in held.items():
                    visit(f"{element}/{key}", part)

    def visit(name: str, entry: Any) -> None:
        nonlocal size, tables
        settings.update({f"{name}/{key}": value for key, value in entry.attrs.items()})
        matlab = _text(entry.attrs.get("MATLAB_class", ""))
        tables = tables or matlab in ("table", "timetable")
        if not isinstance(entry, h5py.Dataset) or matlab in ("table", "timetable"):
            return
        if h5py.check_ref_dtype(entry.dtype) is h5py.Reference and not name.startswith("#"):
            elements(name, entry, matlab)
            return
        if entry.size <= LONGEST_TEXT and (matlab == "char" or h5py.check_string_dtype(entry.dtype)):
            held = entry[()]
            text = "".join(map(chr, np.ravel(held).tolist())) if matlab == "char" else held
            settings[name] = _text(text) if np.size(text) == 1 else text
            return
        if entry.dtype.kind not in "fiub" and not entry.dtype.names:
            return
        if name.startswith("#") or len(arrays) > MOST_CHANNELS:
            return
        size += entry.size * entry.dtype.itemsize
        check_size(path, size)
        arrays[name] = entry[()]

    with h5py.File(path, "r") as file:
        settings.update(file.attrs)
        file.visititems(visit)
    units: dict[str, str] = {}
    if tables:
        columns, units = tables_of(path)
        arrays |= columns
    return array_table(path, arrays, units, settings)


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


FORMAT = Format(
    "HDF5, MATLAB 7.3",
    (".h5", ".hdf5", ".mat"),
    opened,
    begins=(b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"),
    library=("h5py", "h5py"),
    place=40,
    # MATLAB 7.3 by the number in its header, whatever its text says.
    recognises=lambda _, head: head.startswith(b"MATLAB") and head[124:128] in (b"\x00\x02IM", b"\x02\x00MI"),
)
