"""Compile the kernels with numba, or run the same functions uncompiled where numba is missing."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable
from types import ModuleType
from typing import TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])


def _numba() -> ModuleType | None:
    try:
        return importlib.import_module("numba")
    except ImportError:  # the functions stay correct, only slow
        return None


_NUMBA = _numba()
COMPILED: bool = _NUMBA is not None


def compiled(function: Function) -> Function:
    """Return ``function`` compiled (cached on disk, without the interpreter lock), or as it is."""
    if _NUMBA is None:
        return function
    return cast(Function, _NUMBA.njit(cache=True, nogil=True)(function))


def notice() -> str | None:
    """Return what running uncompiled costs, in one line, or ``None`` where the kernels are compiled."""
    if COMPILED:
        return None
    return "numba is not installed: the kernels run uncompiled, 100 times slower; install numba"


if not COMPILED:  # imported once per process, so said once
    logging.getLogger(__name__).warning(notice())
