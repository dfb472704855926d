"""Compilation of the kernels with numba, or run the same functions uncompiled where numba is missing."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import logging
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TypeVar, cast

from spool_core.kernels.kernel_files import MAGIC, keep_sealed, kernel_folder
from spool_core.system import lock_file, private_folder

Function = TypeVar("Function", bound=Callable[..., object])

#: s after which compiled kernels of another version of a package are taken away.
OUTDATED = 30 * 86_400

#: An import: the module, with its dots, and what is taken from it, in brackets or to the end of the line.
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)|import[ \t]+([^\n]*))", re.M
)


_NUMBA: ModuleType | None = None
with suppress(ImportError):  # the functions stay correct, only slow
    _NUMBA = importlib.import_module("numba")
COMPILED: bool = _NUMBA is not None


def notice() -> str | None:
    """Return what running uncompiled costs, in one line, or ``None`` where the kernels are compiled."""
    if COMPILED:
        return None
    return "numba is not installed: the kernels run uncompiled, 100 times slower; install numba"


if not COMPILED:  # imported once per process, so said once
    logging.getLogger(__name__).warning(notice())


def cache_folder() -> Path:
    """Return where kernels are kept; see :func:`~spool_core.kernels.kernel_files.kernel_folder`."""
    return kernel_folder()


def compiled(function: Function) -> Function:
    """Return ``function`` compiled (cached on disk, without the interpreter lock), or as it is."""
    if _NUMBA is None:
        return function
    folder = _folder_of(function.__module__, cache_folder())
    with _cached_in(folder) as cached:
        kernel = _NUMBA.njit(cache=cached, nogil=True)(function)
    if cached:
        keep_sealed(kernel)
    return cast("Function", kernel)


def inlined(function: Function) -> Function:
    """Return ``function`` compiled into each of its compiled callers, which the disk keeps, or as it is.

    For small functions with many arguments in the innermost loop: a call costs more than they do.
    """
    if _NUMBA is None:
        return function
    return cast("Function", _NUMBA.njit(nogil=True, forceinline=True)(function))


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
        lock_file(lock.fileno())
        yield


@lru_cache(maxsize=256)
def _folder_of(module: str, base: Path) -> Path:
    """Return where the kernels of ``module`` are kept, named by its source and all that it imports of ours.

    numba looks at a kernel's own file only: a change in a function that it calls, or in a constant that it
    takes from another module, would find the old kernel. A script, or a module that was generated, has no
    source that can be found by its name: its kernels lie in ``base``, by its own file.
    """
    sources = _closure(module)
    if not sources:
        return base
    digest = hashlib.sha256(MAGIC)
    for name in sorted(sources):
        digest.update(name.encode() + _text(sources[name]).encode())
    folder = base / f"{module}_{digest.hexdigest()[:16]}"
    if not folder.exists():
        for other in base.glob(f"{module}_*"):
            if other.stat().st_mtime < time.time() - OUTDATED:
                shutil.rmtree(other, ignore_errors=True)
    return folder


def _closure(module: str) -> dict[str, Path]:
    """Return the sources of ``module`` and of what it imports, by module, of its own and of our packages."""
    own = module.partition(".")[0]
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        package = name.partition(".")[0]
        path = _source(name) if package == own or package.startswith("spool_") else None
        if path is not None and name not in found:
            found[name] = path
            waiting += _imports(name, path)
    return found


@lru_cache(maxsize=1024)
def _imports(module: str, path: Path) -> tuple[str, ...]:
    """Return the modules that ``module`` at ``path`` may import; some may be names inside of modules."""
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = []
    for source, names, plain in _IMPORT.findall(_text(path)):
        if plain:
            found += [one.split()[0] for one in plain.split("#")[0].split(",") if one.strip()]
            continue
        bare = source.lstrip(".")
        up = len(source) - len(bare)
        start = ".".join(package.split(".")[: 1 - up or None]) if up else ""
        base = ".".join(part for part in (start, bare) if part)
        found.append(base)
        found += [f"{base}.{one}" for one in re.findall(r"\w+", re.sub(r"#[^\n]*|\bas\s+\w+", "", names))]
    return tuple(found)


@lru_cache(maxsize=1024)
def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@lru_cache(maxsize=4096)
def _source(module: str) -> Path | None:
    """Return the file of ``module``; ``None`` for a script's own module and for what is no module."""
    package, _, rest = module.partition(".")
    for root in _roots(package):
        path = root.joinpath(*rest.split(".")) if rest else root
        for candidate in (path / "__init__.py", path.with_suffix(".py")):
            if candidate.is_file():
                return candidate
    return None


@lru_cache(maxsize=64)
def _roots(package: str) -> tuple[Path, ...]:
    try:
        spec = importlib.util.find_spec(package)
    except ValueError:
        return ()
    return tuple(Path(root) for root in (spec.submodule_search_locations if spec else None) or ())


@contextmanager
def _cached_in(folder: Path) -> Iterator[bool]:
    """Let numba keep kernels in ``folder``; yield whether it can keep any."""
    assert _NUMBA is not None
    try:
        private_folder(folder)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    before = _NUMBA.config.CACHE_DIR
    _NUMBA.config.CACHE_DIR = str(folder) if writable else before
    try:
        yield writable
    finally:
        _NUMBA.config.CACHE_DIR = before
