"""Compile the kernels with numba, or run the same functions uncompiled where numba is missing."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])

#: s after which compiled kernels of another version of a package are taken away.
OUTDATED = 30 * 86_400


#: Packages whose kernels those of others call.
CALLED = ("spool_stream", "spool_sim", "spool_estimator")


def _numba() -> ModuleType | None:
    try:
        return importlib.import_module("numba")
    except ImportError:  # the functions stay correct, only slow
        return None


_NUMBA = _numba()
COMPILED: bool = _NUMBA is not None


def cache_folder() -> Path:
    """Return where kernels are kept: ``NUMBA_CACHE_DIR``, else the user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "spool_kernels"
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "spool_sim" / "kernels"


def compiled(function: Function) -> Function:
    """Return ``function`` compiled (cached on disk, without the interpreter lock), or as it is."""
    if _NUMBA is None:
        return function
    folder = _folder_of(function.__module__.partition(".")[0], cache_folder())
    with _cached_in(folder) as cached:
        return cast(Function, _NUMBA.njit(cache=cached, nogil=True)(function))


def inlined(function: Function) -> Function:
    """Return ``function`` compiled into each of its compiled callers, which the disk keeps, or as it is.

    For small functions with many arguments in the innermost loop: a call costs more than they do.
    """
    if _NUMBA is None:
        return function
    return cast(Function, _NUMBA.njit(nogil=True, forceinline=True)(function))


@lru_cache(maxsize=64)
def _folder_of(package: str, base: Path) -> Path | None:
    """Return where the kernels of ``package`` are kept, named by its sources.

    numba looks at a kernel's own file only: a change in a function that it calls would find the old kernel.
    """
    own = _sources(package)
    if not own:
        return None
    digest = hashlib.sha256()
    for path in [*own, *(path for name in CALLED if name != package for path in _sources(name))]:
        digest.update(path.read_bytes())
    folder = base / f"{package}_{digest.hexdigest()[:16]}"
    if not folder.exists():
        for other in base.glob(f"{package}_*"):
            if other.stat().st_mtime < time.time() - OUTDATED:
                shutil.rmtree(other, ignore_errors=True)
    return folder


def _sources(package: str) -> list[Path]:
    """Return the sources of ``package``, none for a script's own module."""
    try:
        spec = importlib.util.find_spec(package)
    except ValueError:
        return []
    roots = (spec.submodule_search_locations if spec else None) or []
    return [path for root in roots for path in sorted(Path(root).rglob("*.py"))]


@contextmanager
def _cached_in(folder: Path | None) -> Iterator[bool]:
    """Let numba keep kernels in ``folder``, or where it likes without one; yield whether it can keep any."""
    assert _NUMBA is not None
    if folder is None:
        yield True
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    before = _NUMBA.config.CACHE_DIR
    _NUMBA.config.CACHE_DIR = str(folder) if writable else before
    try:
        yield writable
    finally:
        _NUMBA.config.CACHE_DIR = before


def notice() -> str | None:
    """Return what running uncompiled costs, in one line, or ``None`` where the kernels are compiled."""
    if COMPILED:
        return None
    return "numba is not installed: the kernels run uncompiled, 100 times slower; install numba"


if not COMPILED:  # imported once per process, so said once
    logging.getLogger(__name__).warning(notice())
