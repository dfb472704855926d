"""Record in a table: any logger's file that `import` reads, taken as it is by the other commands."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from spool_bag.format.metadata import is_bag_file
from spool_bag.importing.records.logger_record import LoggerRecord, read_record
from spool_core.errors import InputError


def is_table(path: Path) -> bool:
    """Return whether ``path`` is a file to be read as a table: any but a bag or a description."""
    if path.is_dir() or is_bag_file(path) or path.suffix.lower() in (".yaml", ".yml"):
        return False
    return path.is_file() or bool(path.suffix)


def record_of_table(
    path: Path, kind: str = "accelerations", columns: Mapping[str, str] | None = None, *, regular: bool = True
) -> LoggerRecord:
    """Return the record in a file; what only `import` can be told is refused with that.

    Raises:
        InputError: as :func:`spool_bag.importing.records.logger_record.read_record`.
    """
    try:
        return read_record(path, kind, columns, regular=regular)
    except InputError as error:
        if re.search(r"--(unit|scale|rate|topic)\b", str(error)):
            raise InputError(
                f"{error}; these are options of ./spool import {path} --out record_bag, which makes a bag "
                f"of it"
            ) from error
        raise
