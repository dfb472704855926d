"""Growing columns: samples that come piece by piece, held once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .table import MOST_SAMPLES, Values, too_long

#: Samples of the first piece of memory.
_FIRST = 1 << 16


class GrowingColumns:
    """Growing columns by name; those in ``single`` are held as float32.

    A row is lengthened where it lies, as the system moves pages: neither a list of pieces nor their copy
    into one row is ever held beside it.
    """

    def __init__(self, path: Path, names: Sequence[str], single: Sequence[str]) -> None:
        self.rows = 0
        self._path = path
        self._single = frozenset(single)
        self._columns: dict[str, NDArray[Any] | None] = dict.fromkeys(names)

    def add(self, piece: dict[str, NDArray[Any]]) -> None:
        """Append a piece of every column.

        Raises:
            InputError: the record is longer than :data:`MOST_SAMPLES`.
        """
        count = next(iter(piece.values())).size
        if self.rows + count > MOST_SAMPLES:
            raise too_long(self._path)
        for name, values in piece.items():
            column = self._columns[name]
            if column is None:
                kind = np.float32 if name in self._single else values.dtype
                column = self._columns[name] = np.empty(max(count, _FIRST), dtype=kind)
            if self.rows + count > column.size:
                column.resize(min(MOST_SAMPLES, max(self.rows + count, 2 * column.size)), refcheck=False)
            with np.errstate(over="ignore"):  # what float32 cannot hold is refused as infinite
                column[self.rows : self.rows + count] = values
        self.rows += count

    def take(self) -> dict[str, Values]:
        """Return the columns, shape (n,) each."""
        for column in self._columns.values():
            if column is not None:
                column.resize(self.rows, refcheck=False)
        return {name: np.empty(0) if column is None else column for name, column in self._columns.items()}
