"""Validation of files against a schema, with the place and the remedy of each error."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationError
from spool_core.errors import InputError
from spool_core.files import read_yaml

#: Faults that one line of error names.
MOST_FAULTS = 10


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not a yes/no value")
    return value


# YAML 1.1 reads 15e-6 as text: text that is a number is taken as the number.
Number = Annotated[float, BeforeValidator(_refuse_boolean), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """Return the mapping that the YAML file ``path`` holds.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: as :func:`read_yaml`, or not a mapping with text keys.
    """
    content = read_yaml(path, what)
    if not isinstance(content, dict) or not all(isinstance(key, str) for key in content):
        raise InputError(f"{path}: a {what} file is a list of 'key: value' lines, this one is not")
    return content


def one_line(error: ValidationError, where: str, known: tuple[str, ...] = ()) -> InputError:
    """Return the user's error for what pydantic found: every fault, with its key path, in one line.

    Args:
        error: what pydantic raised.
        where: file or parameter that was read.
        known: keys that are allowed, named when an unknown key was found.
    """
    faults = []
    for fault in error.errors(include_url=False):
        path = ".".join(str(part) for part in fault["loc"])
        if fault["type"] == "extra_forbidden":
            listed = f" (known: {', '.join(known)})" if known else ""
            faults.append(f"{path}: unknown key, remove or correct it{listed}")
        elif fault["type"] == "missing":
            faults.append(f"{path}: key is missing, add it")
        else:
            given = "" if isinstance(fault["input"], dict) else f", got {_shortened(fault['input'])}"
            message = fault["msg"].removeprefix("Value error, ")
            said = f"{message[0].lower()}{message[1:]}{given}"
            faults.append(f"{path}: {said}" if path else said)
    if len(faults) > MOST_FAULTS:
        faults = [*faults[:MOST_FAULTS], f"and {len(faults) - MOST_FAULTS} more"]
    return InputError(f"{where}: {'; '.join(faults)}".replace("\n", " "))


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
