"""Compile lock: one process at a time compiles, the others wait and load what it compiled from the disk."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager

from .compiled import cache_folder


@contextmanager
def alone() -> Iterator[None]:
    """Hold the lock of the kernels' cache; where there is no cache that can be written, hold nothing."""
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "compiling.lock").open("a")
    except (OSError, RuntimeError):  # RuntimeError: there is no home folder
        yield
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
