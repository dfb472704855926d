"""MATLAB's files up to version 7: arrays and fields of structures by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spool_import.tables.arrays import array_table
from spool_import.tables.table import ArrayTable, check_size

from .format import Format

#: Structures within structures that are looked into.
DEEPEST = 4


def opened(path: Path) -> ArrayTable:
    """Return the arrays of a file; what is no number is left out."""
    from scipy.io import loadmat  # noqa: PLC0415 - 30 MB that others do not need

    check_size(path)
    held = loadmat(path, squeeze_me=True, struct_as_record=False)
    arrays: dict[str, Any] = {}
    units: dict[str, str] = {}
    for name, value in held.items():
        if not name.startswith("__"):
            _collect(name, value, arrays, units, DEEPEST)
    return array_table(path, arrays, units)


def _collect(name: str, value: Any, arrays: dict[str, Any], units: dict[str, str], deeper: int) -> None:
    fields = getattr(value, "_fieldnames", None)
    if fields is None:
        array = np.asarray(value)
        if array.dtype.kind in "fiub":
            arrays[name] = array
        return
    if deeper == 0:
        return
    for field in fields:
        entry = getattr(value, field)
        if isinstance(entry, str):
            if field.lower() in ("unit", "units"):
                units |= {f"{name}/{other}": entry for other in fields}
            elif field.lower().endswith(("_unit", "_units")):
                units[f"{name}/{field.rpartition('_')[0]}"] = entry
            continue
        _collect(f"{name}/{field}", entry, arrays, units, deeper - 1)


FORMAT = Format("MATLAB", (".mat",), opened, begins=(b"MATLAB 5.0",))
