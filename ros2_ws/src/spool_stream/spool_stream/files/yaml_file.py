"""Bounded YAML reading: a few hundred bytes can stand for gigabytes, or end the stack."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from spool_stream.errors import InputError

#: Characters; the largest file that users write, a launch file's list of 1000 valves, has some 100 kB.
LARGEST = 1_000_000
#: Levels and values; users' files have 3 levels and a few hundred values, a bag's metadata nests 8 deep.
DEEPEST = 32
MOST_VALUES = 50_000

# libyaml's parser, where PyYAML has it, takes a tenth of the time.
_Loader: type[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class YamlError(ValueError):
    """A text is no YAML, or beyond the bounds; the message is one line."""


def load_yaml(text: str, *, largest: int = LARGEST, most_values: int = MOST_VALUES) -> Any:
    """Return what ``text`` holds, of plain types only.

    Raises:
        YamlError: not YAML, more than ``largest`` characters or ``most_values`` values, nested deeper than
            ``DEEPEST``, with aliases or with a key twice in one mapping.
    """
    if len(text) > largest:
        raise YamlError(f"it has more than {largest} characters: give a shorter one")
    try:
        _check_events(yaml.parse(text, Loader=_Loader), most_values)
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            _refuse_repeated_keys(node)
            return None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        place = f" in line {error.problem_mark.line + 1}" if error.problem_mark is not None else ""
        raise YamlError(f"not valid YAML{place}: {_short(error.problem)}; correct that line") from None
    except yaml.YAMLError as error:
        raise YamlError(f"not valid YAML: {_short(error)}; correct it") from None
    except YamlError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        # What PyYAML makes of a value that looks like a date or carries a tag, e.g. 2020-99-99.
        raise YamlError(f"not valid YAML: a value can't be read ({_short(error)}); correct it") from None


def read_yaml(path: str | Path, what: str) -> Any:
    """Return what the YAML file ``path`` holds, of plain types only.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: no such file, or as :func:`load_yaml`; file, line and remedy are named.
    """
    try:
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(LARGEST + 1)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise InputError(
            f"{path}: cannot read the {what} file: {reason}; give the path of a YAML file"
        ) from None
    try:
        return load_yaml(text)
    except YamlError as error:
        raise InputError(f"{path}: {error}") from None


def _check_events(events: Iterator[yaml.Event], most_values: int) -> None:
    """Raise MarkedYAMLError for what would cost more than its size to compose."""
    depth = values = 0
    for event in events:
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        values += isinstance(event, yaml.NodeEvent)
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases (*) are not read, write the value out", event)
        if depth > DEEPEST:
            raise _refusal(f"it is nested deeper than {DEEPEST} levels", event)
        if values > most_values:
            raise _refusal(f"it has more than {most_values} values", event)


def _refusal(problem: str, event: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


def _refuse_repeated_keys(node: yaml.Node | None) -> None:
    """Raise YamlError for a key that stands twice in one mapping; YAML readers keep the last silently."""
    if isinstance(node, yaml.SequenceNode):
        for entry in node.value:
            _refuse_repeated_keys(entry)
    if not isinstance(node, yaml.MappingNode):
        return
    seen: set[str] = set()
    for key, value in node.value:
        if isinstance(key, yaml.ScalarNode):
            if key.value in seen:
                line = key.start_mark.line + 1
                raise YamlError(f"key '{key.value}' stands twice (again in line {line}); keep one of them")
            seen.add(key.value)
        _refuse_repeated_keys(key)
        _refuse_repeated_keys(value)


def _short(problem: object) -> str:
    return " ".join(str(problem).split())[:200]
