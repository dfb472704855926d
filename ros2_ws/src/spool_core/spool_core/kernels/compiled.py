"""Compilation of the kernels with numba, or run the same functions uncompiled where numba is missing."""

from __future__ import annotations

import enum
import hashlib
import importlib
import logging
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

from spool_core.kernels.kernel_files import keep_on_disk, kernel_folder
from spool_core.system import lock_file

Function = TypeVar("Function", bound=Callable[..., object])

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


def compiled(function: Function) -> Function:
    """Return ``function`` compiled (cached on disk, without the interpreter lock), or as it is."""
    kernel = inner(function)
    keep_on_disk(kernel, lambda: str(Digest(kernel)))
    return kernel


def inner(function: Function) -> Function:
    """Return ``function`` compiled for its compiled callers, with which the disk keeps it, or as it is."""
    if _NUMBA is None:
        return function
    return cast("Function", _NUMBA.njit(nogil=True)(function))


def inlined(function: Function) -> Function:
    """Return ``function`` compiled as ``inner`` does, but into the body of each caller.

    For small functions with many arguments in the innermost loop: a call costs more than they do.
    """
    if _NUMBA is None:
        return function
    return cast("Function", _NUMBA.njit(nogil=True, forceinline=True)(function))


@contextmanager
def alone() -> Iterator[None]:
    """Hold the lock of the kernels' cache; where there is no cache that can be written, hold nothing."""
    try:
        folder = kernel_folder()
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / "compiling.lock").open("a")
    except (OSError, RuntimeError):  # RuntimeError: no home directory
        yield
        return
    with lock:
        lock_file(lock.fileno())
        yield


class Digest:
    """Hash of all that numba compiles into a kernel: its code, and what its global names hold.

    numba freezes what these names hold when it compiles: functions, compiled likewise, and constants. So this
    follows the names as they are now, whichever modules they come from. What only documents (docstrings,
    annotations, comments, the place in the file) does not count.
    """

    def __init__(self, kernel: Any) -> None:
        """Take all of the dispatcher ``kernel``."""
        self._hash = hashlib.sha256(repr(sys.version_info[:2]).encode())
        self._own = (kernel.__module__ or "").partition(".")[0]
        self._met: set[tuple[int, frozenset[str]]] = set()
        self._take(kernel, frozenset())

    def __str__(self) -> str:
        return self._hash.hexdigest()

    def _write(self, *parts: object) -> None:
        self._hash.update(repr(parts).encode())

    def _take(self, value: Any, names: frozenset[str]) -> None:
        """Take ``value``; of a module, what ``names`` can mean there: those of the code that holds it."""
        if isinstance(value, (tuple, list)):
            self._write(type(value).__name__, len(value), getattr(value, "_fields", None))
            for one in value:
                self._take(one, names)
        elif isinstance(value, (set, frozenset)):
            self._write("set", sorted(map(repr, value)))
        elif isinstance(value, (FunctionType, ModuleType, type)) or hasattr(value, "py_func"):
            self._write(type(value).__name__, getattr(value, "__module__", None), value.__name__)
            met = id(value), names if isinstance(value, ModuleType) else frozenset[str]()
            if met not in self._met:
                self._met.add(met)
                self._follow(value, names)
        elif hasattr(value, "tobytes") and hasattr(value, "dtype"):
            self._write("array", value.dtype.descr, value.shape, value.tobytes())
        elif value is None or isinstance(value, (bool, int, float, complex, str, bytes)):
            self._write(type(value).__name__, value)
        else:
            try:
                self._write(pickle.dumps(value))
            except (pickle.PicklingError, TypeError, AttributeError):
                self._write(os.urandom(16))  # no kernel is taken for this one

    def _follow(self, value: Any, names: frozenset[str]) -> None:
        """Take what a function, a module or a class holds; what a library has changes with its version."""
        if hasattr(value, "py_func"):
            self._write(sorted(value.targetoptions.items()))
            self._function(value.py_func)
        elif isinstance(value, type):
            self._take(getattr(value, "_fields", None), names)
            if issubclass(value, enum.Enum):
                self._take([(one.name, one.value) for one in value], names)
        else:
            module = value.__name__ if isinstance(value, ModuleType) else value.__module__ or ""
            package = module.partition(".")[0]
            if package != self._own and not package.startswith("spool_"):
                return
            if isinstance(value, ModuleType):
                self._held(vars(value), names)
            else:
                self._function(value)

    def _function(self, value: FunctionType) -> None:
        names = self._code(value.__code__, value.__doc__)
        self._held(value.__globals__, names)
        self._take([cell.cell_contents for cell in value.__closure__ or ()], names)
        self._take((value.__defaults__, sorted((value.__kwdefaults__ or {}).items())), names)

    def _code(self, code: CodeType, document: str | None = None) -> frozenset[str]:
        """Take code without its docstring; return its names, with those of the code within it."""
        self._write(code.co_code, getattr(code, "co_exceptiontable", None), code.co_flags, code.co_argcount)
        self._write(code.co_posonlyargcount, code.co_kwonlyargcount, code.co_names, code.co_varnames)
        self._write(code.co_cellvars, code.co_freevars)
        names = frozenset(code.co_names)
        documented = code.co_consts[:1] == (document,)
        for one in code.co_consts[documented:]:
            if isinstance(one, CodeType):
                names |= self._code(one)
            else:
                self._take(one, frozenset())
        return names

    def _held(self, holder: dict[str, Any], names: frozenset[str]) -> None:
        for name in sorted(names & holder.keys()):
            self._write(name)
            self._take(holder[name], names)
