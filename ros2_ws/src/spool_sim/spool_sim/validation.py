"""What every YAML file of the suite has in common: reading it and saying in one line what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BeforeValidator, Field, ValidationError
from spool_stream.errors import InputError


def _refuse_boolean(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number, not a yes/no value")
    return value


# YAML 1.1 reads 15e-6 as text: text that is a number is taken as the number.
Number = Annotated[float, BeforeValidator(_refuse_boolean), Field(allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0.0)]
NotNegative = Annotated[Number, Field(ge=0.0)]


def _refuse_repeated_keys(node: yaml.Node | None) -> None:
    """Raise InputError for a key that stands twice in one mapping; YAML readers keep the last silently."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if key.value in seen:
                raise InputError(f"key '{key.value}' stands twice (again in line {key.start_mark.line + 1})")
            seen.add(str(key.value))
            _refuse_repeated_keys(value)
    elif isinstance(node, yaml.SequenceNode):
        for entry in node.value:
            _refuse_repeated_keys(entry)


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """Return the mapping that the YAML file ``path`` holds.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: no such file, not YAML, or not a mapping with text keys.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise InputError(
            f"{path}: cannot read the {what} file: {reason}; give the path of a YAML file"
        ) from None
    try:
        _refuse_repeated_keys(yaml.compose(text, Loader=yaml.SafeLoader))
        content = yaml.safe_load(text)
    except InputError as error:
        raise InputError(f"{path}: {error}; keep one of them") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "syntax error"
        raise InputError(f"{path}: not valid YAML{place}: {problem}; correct that line") from None
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
        path = ".".join(str(part) for part in fault["loc"]) or "value"
        if fault["type"] == "extra_forbidden":
            listed = f" (known: {', '.join(known)})" if known else ""
            faults.append(f"{path}: unknown key, remove or correct it{listed}")
        elif fault["type"] == "missing":
            faults.append(f"{path}: key is missing, add it")
        else:
            given = "" if isinstance(fault["input"], dict) else f", got {fault['input']!r}"
            message = fault["msg"].removeprefix("Value error, ")
            faults.append(f"{path}: {message[0].lower()}{message[1:]}{given}")
    return InputError(f"{where}: {'; '.join(faults)}".replace("\n", " "))
