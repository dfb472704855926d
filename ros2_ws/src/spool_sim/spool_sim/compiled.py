"""Compile the kernels with numba, or run the same functions uncompiled where numba is missing."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])

# Without numba the functions stay correct, only slow.
COMPILED: bool = importlib.util.find_spec("numba") is not None


def compiled(function: Function) -> Function:
    """Return ``function`` compiled (cached on disk, without the interpreter lock), or as it is."""
    if not COMPILED:
        return function
    numba = importlib.import_module("numba")
    return cast(Function, numba.njit(cache=True, nogil=True)(function))


def notice() -> str | None:
    """Return the line to log at start when the kernels run uncompiled, else ``None``."""
    if COMPILED:
        return None
    return "numba is not installed: the kernels run uncompiled, 100 times slower"
