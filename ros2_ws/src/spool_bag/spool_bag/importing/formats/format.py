"""Formats that are read: each a module `*_format.py` of this package; there is no other list of them."""

from __future__ import annotations

import csv
import importlib
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spool_core.discovery import modules_of
from spool_core.errors import InputError, how_to_install
from spool_core.faults import raised_by_library
from spool_core.text import printable

from spool_bag.importing.table import Group, Table, Values, numbered

#: What bad bytes bring in the readers of this package; their libraries may raise anything.
DAMAGE = (ValueError, EOFError, ArithmeticError, struct.error, csv.Error, zlib.error)


@dataclass(frozen=True, slots=True)
class Format:
    """Format, declared as ``FORMAT`` by its module.

    Attributes:
        name: for people, e.g. ``NI TDMS``.
        suffixes: of its files, lower case.
        opened: gives the table of a file.
        begins: first bytes by which a file is known whatever its name; none where there are no such.
        folder: whether a folder may be one.
        library: name of a package that comes with `extras` alone, and the module it is imported by.
        place: in the order in which formats are asked; the lowest comes first.
        recognises: whether a file with certain first bytes is one, where no fixed ones say it.
    """

    name: str
    suffixes: tuple[str, ...]
    opened: Callable[[Path], Table]
    begins: tuple[bytes, ...] = ()
    folder: bool = False
    library: tuple[str, str] | None = None
    place: int = 50
    recognises: Callable[[Path, bytes], bool] | None = None

    def fits(self, path: Path, head: bytes) -> bool:
        """Return whether a file is of this format by its name or first bytes."""
        if path.is_dir():
            return self.folder
        if any(head.startswith(mark) for mark in self.begins):
            return True
        if self.recognises is not None and self.recognises(path, head):
            return True
        return not self.begins and path.name.lower().endswith(self.suffixes)


#: Names of archives, of which none but a single packed text is read.
_PACKED = (".zip", ".bz2", ".xz", ".7z", ".gz", ".tar", ".tgz", ".rar")


@cache
def formats() -> tuple[Format, ...]:
    """Return all formats in the order in which they are asked."""
    found = [module.FORMAT for module in modules_of(__package__ or "", "_format")]
    return tuple(sorted(found, key=lambda one: (one.place, one.name)))


def open_table(path: Path) -> Table:
    """Return the table that the file at ``path`` holds.

    Raises:
        InputError: no such file, unknown format, damaged, or its library is missing.
    """
    form = format_of(path)
    if form.library is not None:
        package, module = form.library
        try:
            importlib.import_module(module)
        except ImportError:
            raise InputError(
                f"{path}: {form.name} is read by the package {package}, which is not installed: "
                f"{how_to_install(package)}, or export the record as CSV"
            ) from None
    with _understood(path, form):
        table = form.opened(path)
        table.groups = tuple(numbered(group) for group in table.groups)
        return table


def read_channels(
    table: Table, group: Group, names: Sequence[str], single: Sequence[str]
) -> dict[str, Values]:
    """Return channels of a table, as :meth:`Table.read` does; whatever its library meets is an InputError."""
    with _understood(table.path, format_of(table.path)):
        found = table.taken(group, names, single)
    sizes = {name: row.size for name, row in found.items()}
    short, long = min(sizes, key=lambda name: sizes[name]), max(sizes, key=lambda name: sizes[name])
    if sizes[short] != sizes[long]:
        raise InputError(
            f"{table.path}: {printable(short, 40)} has {sizes[short]} samples and {printable(long, 40)} "
            f"{sizes[long]}: name channels of one length with --columns"
        )
    return found


@contextmanager
def _understood(path: Path, form: Format) -> Iterator[None]:
    """Turn what a library raises over a damaged file into one line."""
    try:
        yield
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: it does not fit into memory: split it") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:
        if not (raised_by_library(error) or isinstance(error, DAMAGE)):
            raise  # a fault of the suite
        raise InputError(
            f"{path}: it cannot be read as {form.name} ({type(error).__name__}): is it cut off or damaged? "
            "copy it again"
        ) from error


def format_of(path: Path) -> Format:
    """Return the format of a file or folder, by its first bytes or its name.

    Raises:
        InputError: no such file, or unknown format.
    """
    head = b""
    if path.is_fifo():
        raise InputError(f"{path}: a pipe, which can be read only once: write it to a file first")
    if not path.is_dir():
        try:
            with path.open("rb") as file:
                head = file.read(512)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
        if not head:
            raise InputError(f"{path}: the file is empty")
    for form in formats():
        if form.fits(path, head):
            return form
    if path.suffix.lower() in _PACKED:
        raise InputError(f"{path}: a packed file: unpack it first")
    known = ", ".join(f"{form.name} ({' '.join(form.suffixes)})" for form in formats() if form.suffixes)
    raise InputError(f"{path}: unknown file format; supported: {known}")
