"""NumPy's files: arrays by name (.npz), or one array (.npy)."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from spool_bag.importing.formats.format import Format
from spool_bag.importing.table import ArrayTable, array_table, check_size


def opened(path: Path) -> ArrayTable:
    """Return the arrays of a file; pickled objects, which could run code, are refused by NumPy."""
    if path.suffix.lower() == ".npy":
        check_size(path)
        return array_table(path, {"data": np.load(path, allow_pickle=False)})
    with zipfile.ZipFile(path) as packed:
        check_size(path, sum(entry.file_size for entry in packed.infolist()))
    with np.load(path, allow_pickle=False) as held:
        return array_table(path, {name: held[name] for name in held.files})


FORMAT = Format("NumPy", (".npz", ".npy"), opened)
