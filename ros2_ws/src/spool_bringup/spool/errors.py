"""One exception type: wrong calls, files and libraries become an ``InputError`` in the words of Python."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable
from functools import wraps
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

from spool_core.errors import InputError, refused_by_system, unmet_library
from spool_core.text import did_you_mean
from spool_report.terminal import silently

Given = ParamSpec("Given")
Found = TypeVar("Found")

#: Types of arguments that are checked before any work, by their names in annotations.
_TYPES: dict[str, type] = {
    "bool": bool, "int": Integral, "float": Real, "str": str, "Path": os.PathLike, "None": type(None),
}  # fmt: skip
#: Options of commands that are true or false, that hold pairs, and those of another name here.
_SWITCHES = (
    "thorough", "profiles", "sensor_gain", "sensor_delay", "force_free", "empty_as_gap", "together", "refits",
)  # fmt: skip
_PAIRS = ("columns", "unit", "scale", "topic")
_OTHER_NAMES = {"force": "replace"}
_VALUE = r"""'[^']*'|[^\s'"=]+=[^\s;]*[^\s;,.:]|(?<=--id )\w+|-?\d[\d.]*(?=[\s,;:]|$)"""
_OPTION = re.compile(rf"--([a-z][a-z0-9-]*)(?:[ =]({_VALUE}))?")


def one_error(function: Callable[Given, Found]) -> Callable[Given, Found]:
    """Return ``function`` raising ``InputError`` also for wrong calls, missing files and libraries.

    It shows no progress.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def checked(*arguments: Given.args, **named: Given.kwargs) -> Found:
        _check_call(signature, f"spool.{function.__name__}", arguments, named)
        try:
            with silently():
                return function(*arguments, **named)
        except InputError as error:
            raise InputError(in_python(str(error))) from error
        except OSError as error:
            raise InputError(refused_by_system(error)) from error
        except ImportError as error:
            said = unmet_library(error)
            if said is None:
                raise
            raise InputError(said) from error

    return checked


def in_python(text: str) -> str:
    """Return a message of a command with its options as arguments: ``--rate 2000`` becomes ``rate=2000``."""
    text = re.sub(r"; these are options of \./spool import .* of it$", "; pass it to spool.read", text)
    text = re.sub(r"^valve new:", "spool.valve:", text)
    said = _OPTION.sub(_argument, text)
    return re.sub(r"\b(?:[Tt]ype|give) (?=\w+=)", "pass ", said)


def _argument(option: re.Match[str]) -> str:
    name, value = option[1].replace("-", "_"), option[2] or ""
    name = _OTHER_NAMES.get(name, name)
    if name in _SWITCHES or name == "replace":
        return f"{name}=True" + (f" {value}" if value else "")
    words = value.strip("'")
    if name in _PAIRS and "=" in words:
        pairs = dict(pair.partition("=")[::2] for pair in re.split(r",(?=\s*[A-Za-z]\w*\s*=)", words))
        return f"{name}={pairs!r}"
    if "=" in words:
        words = repr(words)
    return f"{name}={words}"


def _check_call(
    signature: inspect.Signature, name: str, given: tuple[Any, ...], named: dict[str, Any]
) -> None:
    """Refuse arguments that are unknown, missing or of another type.

    Raises:
        InputError: the argument is named, and what it takes.
    """
    known = [key for key in signature.parameters if key != "self"]
    for key in named:
        if key not in signature.parameters:
            hint = did_you_mean(key, known)
            raise InputError(f"{name}: no argument {key!r}{hint}; it takes {', '.join(known)}")
    try:
        bound = signature.bind(*given, **named)
    except TypeError as error:
        raise InputError(f"{name}: {error}; it takes {', '.join(known)}") from None
    for key, value in bound.arguments.items():
        kinds = str(signature.parameters[key].annotation).split(" | ")
        if not all(kind in _TYPES for kind in kinds):
            continue
        number = isinstance(value, bool) and "bool" not in kinds  # True counts as 1 in Python
        if number or not isinstance(value, tuple(_TYPES[kind] for kind in kinds)):
            wanted = " or ".join(kinds)
            raise InputError(f"{name}: {key}={value!r:.60} is no {wanted}: pass a value of that type")
