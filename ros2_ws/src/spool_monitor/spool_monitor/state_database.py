"""The SQLite file of one valve's monitor, which holds all that it keeps: opening, versions, locks, damage."""

from __future__ import annotations

import os
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from spool_core.errors import InputError
from spool_core.system import FILE_MODE, private_file, restrict

#: Name of the file in a valve's folder.
FILE = "trends.sqlite"

#: SQLite's user_version of the files that this version writes; those without one (0) are of the same form.
VERSION = 1

#: s that a writing waits for the process that holds the file, e.g. a copy that is being made of it.
PATIENCE = 5.0

_ASIDE = threading.Lock()
_Part = TypeVar("_Part", bound="StateDatabase")


class LaterVersionError(InputError):
    """One of the suite wrote the file; this one must not change it."""


class StateDatabase:
    """Part of one valve's file; a kill or a power loss costs what was not written yet, never the file.

    Only its owner may read a file that is written. ``patience`` is how long a writing waits for another
    program's lock, s. A subclass names its tables.

    Raises:
        LaterVersionError: a later version of the suite wrote it.
        InputError: the file is none of ours or damaged; it is named.
        OSError: it can't be opened or made, or another program holds it.

    """

    #: SQL that makes the tables where they are missing.
    SCHEMA: ClassVar[str] = ""
    #: SQL that fails where a table is missing.
    PROBES: ClassVar[tuple[str, ...]] = ()
    #: Whether it reads, but never changes, a file that a later version of the suite wrote.
    READS_LATER: ClassVar[bool] = False

    def __init__(self, path: Path, *, read_only: bool = False, patience: float = PATIENCE) -> None:
        self.path = path
        if read_only and not path.is_file():
            raise InputError(f"{path}: no such file")
        mode = "ro" if read_only else "rwc"
        log = path.with_name(f"{path.name}-wal")
        if read_only and not log.exists() and not os.access(path.parent, os.W_OK):
            mode = "ro&immutable=1"  # SQLite would write next to it
        if not read_only:
            if not path.exists():  # closing it would release this process's locks of a file in use
                private_file(path)  # SQLite gives the files next to it the same permissions
            for ending in ("", "-wal", "-shm"):
                restrict(path.with_name(path.name + ending), FILE_MODE)
        with named(path):
            # Written by one worker thread, opened and closed by the node's.
            self.base = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}", patience, uri=True, check_same_thread=False
            )
        try:
            with named(path):
                (version,) = self.base.execute("PRAGMA user_version").fetchone()
                self.version = version
                if version > VERSION and not (read_only and self.READS_LATER):
                    raise LaterVersionError(
                        f"{path}: a later version of the suite wrote it (format {version}, not {VERSION})"
                    )
                if not read_only:
                    self.base.execute("PRAGMA journal_mode=WAL")
                    self.base.execute("PRAGMA synchronous=FULL")
                    self.base.executescript(self.SCHEMA)
                    if version < VERSION:
                        self.base.execute(f"PRAGMA user_version={VERSION}")
                for probe in self.PROBES:
                    self.base.execute(probe)
        except BaseException:
            self.base.close()
            raise
        self._file = _identity(path)

    def check_file(self) -> None:
        """Raise OSError where another file has taken the place of the open one."""
        if _identity(self.path) != self._file:
            raise OSError(f"{self.path}: it was removed or replaced while it was in use")

    def ask(self, question: str, kinds: tuple[Any, ...], values: tuple[object, ...] = ()) -> list[Any]:
        """Return the rows that SQLite, which keeps anything in any column, gives; of these ``kinds``."""
        with named(self.path):
            rows = self.base.execute(question, values).fetchall()
        if not all(isinstance(value, kind) for row in rows for value, kind in zip(row, kinds, strict=True)):
            raise InputError(f"{self.path}: it is damaged (a value is of the wrong kind)")
        return rows

    def close(self) -> None:
        """Close the file."""
        self.base.close()


def own_file(path: Path, patience: float = PATIENCE) -> Path:
    """Return the file that this version keeps its state in.

    That is ``path``, or, where a later version wrote that one, ``NAME.format1.sqlite`` next to it.
    """
    try:
        StateDatabase(path, read_only=True, patience=patience).close()
    except LaterVersionError:
        return path.with_name(f"{path.stem}.format{VERSION}{path.suffix}")
    except (InputError, OSError):
        pass  # said by the one who opens it
    return path


def opened(
    part: type[_Part], path: Path, warn: Callable[[str], None], patience: float, **settings: Any
) -> _Part:
    """Open ``part`` of the file that this version keeps (:func:`own_file`) for writing, with ``settings``.

    A damaged file gets the name ``NAME.damaged``, which ``warn`` is called with, and a new one is begun.

    Raises:
        OSError: it can't be opened or made now.
    """
    path = own_file(path, patience)
    with _ASIDE:  # another thread must not put the new file aside
        try:
            return part(path, patience=patience, **settings)
        except LaterVersionError as error:
            raise OSError(str(error)) from error
        except InputError as error:
            put_aside(path, error, warn)
            return part(path, patience=patience, **settings)


def put_aside(path: Path, reason: InputError, warn: Callable[[str], None]) -> None:
    """Rename the damaged file ``path`` to ``NAME.damaged``.

    Raises:
        OSError: it can't be renamed.
    """
    warn(f"{reason}: the monitor renames it to {path.name}.damaged and starts a new file")
    path.replace(path.with_name(f"{path.name}.damaged"))
    for ending in ("-wal", "-shm"):  # they belong to the damaged one
        path.with_name(path.name + ending).unlink(missing_ok=True)


def valves_in(base: Path) -> dict[str, Path]:
    """Return the file of each valve whose monitor keeps its state below ``base``, by namespace, sorted."""
    files = {str(one.parent.parent.relative_to(base)): own_file(one) for one in base.glob(f"**/{FILE}")}
    return dict(sorted(files.items()))


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what the file at ``path`` is distinguished from another one by, ``None`` where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Raise what SQLite raises as InputError (the file is damaged or none of ours) or OSError."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        if "no such" in str(error):
            raise InputError(f"{path}: it holds no trends of a valve") from error
        busy = (sqlite3.IntegrityError, sqlite3.OperationalError, sqlite3.ProgrammingError)
        if isinstance(error, busy) and not any(words in str(error) for words in ("unsupported", "decode")):
            raise OSError(f"{path}: {error}") from error
        raise InputError(f"{path}: it is damaged ({error})") from error
