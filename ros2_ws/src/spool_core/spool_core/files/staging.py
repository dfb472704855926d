"""Write under another name in the same folder and rename when whole: what has its final name is complete."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_MARK = ".partial-"


def partial_name(target: Path) -> Path:
    """Return where ``target`` is written until it is whole: ``.NAME.partial-PID`` beside it."""
    return target.with_name(f".{target.name}{_MARK}{os.getpid()}")


def leftovers(target: Path) -> list[Path]:
    """Return what processes that ended before they were done left of ``target``."""
    pattern = re.compile(re.escape(f".{target.name}{_MARK}") + r"(\d{1,10})")
    try:
        found = [(entry, pattern.fullmatch(entry.name)) for entry in target.absolute().parent.iterdir()]
    except OSError:
        return []
    return sorted(entry for entry, name in found if name and not _running(int(name[1])))


def remove(path: Path) -> None:
    """Remove a file or folder, whatever of it is there; a link is removed, not what it points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def staged(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield the path to write to; it gets the name ``target`` at the end, or is removed on any exception.

    What was left of ``target`` by a process that was killed is removed first.

    Raises:
        FileExistsError: at the end, where something has the name ``target`` and ``replace`` is false.
    """
    for left in leftovers(target):
        remove(left)
    part = partial_name(target)
    remove(part)
    try:
        yield part
        if replace:
            part.replace(target)
        else:
            _appear(part, target)
    finally:
        remove(part)


def _appear(part: Path, target: Path) -> None:
    """Give the finished file its name, unless something has taken it meanwhile."""
    try:
        os.link(part, target, follow_symlinks=False)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if os.path.lexists(target):
            raise FileExistsError(target) from None
        part.rename(target)


def _running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
