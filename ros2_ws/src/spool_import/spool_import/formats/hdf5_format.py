"""HDF5, and MATLAB's files from version 7.3 on: datasets by path, units and rate from their attributes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from spool_import.tables.arrays import array_table, stated_rate
from spool_import.tables.table import MOST_CHANNELS, ArrayTable, check_size

from .format import Format

_UNITS = ("unit", "units", "Unit", "Units", "UNIT", "UNITS")


def opened(path: Path) -> ArrayTable:
    """Return the datasets of a file, by their paths."""
    import h5py  # noqa: PLC0415 - comes with the extras

    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    settings: dict[str, Any] = {}
    size = 0

    def visit(name: str, entry: Any) -> None:
        nonlocal size
        settings.update(entry.attrs)
        matlab = _text(entry.attrs.get("MATLAB_class", ""))
        if (
            not isinstance(entry, h5py.Dataset)
            or matlab in ("char", "cell")
            or entry.dtype.kind not in "fiub"
        ):
            return
        if name.startswith("#") or len(arrays) > MOST_CHANNELS:
            return
        size += entry.size * entry.dtype.itemsize
        check_size(path, size)
        arrays[name] = entry[()]
        for key in _UNITS:
            if key in entry.attrs:
                units[name] = _text(entry.attrs[key])

    with h5py.File(path, "r") as file:
        settings.update(file.attrs)
        file.visititems(visit)
    rate = stated_rate(settings)
    return array_table(path, arrays, units, {} if math.isnan(rate) else {"rate": rate})


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


FORMAT = Format(
    "HDF5, MATLAB 7.3",
    (".h5", ".hdf5", ".mat"),
    opened,
    begins=(b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"),
    library=("h5py", "h5py"),
    place=40,
)
