"""One exception type: what goes wrong with files and libraries becomes an ``InputError``."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from spool_core.errors import InputError, refused_by_system, unmet_library

Given = ParamSpec("Given")
Found = TypeVar("Found")


def one_error(function: Callable[Given, Found]) -> Callable[Given, Found]:
    """Return ``function`` raising ``InputError`` also for missing files and libraries; show no progress."""

    @wraps(function)
    def checked(*arguments: Given.args, **named: Given.kwargs) -> Found:
        try:
            from spool_tools.terminal import silently  # noqa: PLC0415 - slow to load

            with silently():
                return function(*arguments, **named)
        except OSError as error:
            raise InputError(refused_by_system(error)) from error
        except ImportError as error:
            said = unmet_library(error)
            if said is None:
                raise
            raise InputError(said) from error

    return checked
