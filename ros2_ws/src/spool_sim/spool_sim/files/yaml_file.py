"""YAML from a user's file, within bounds: a few hundred bytes can stand for gigabytes, or end the stack."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from spool_stream.errors import InputError

#: Characters; the largest file of the suite, a launch file's list of 1000 valves, has some 100 kB.
LARGEST = 1_000_000

#: Levels and values; the files of the suite have 3 levels and a few hundred values.
DEEPEST = 32
MOST_NODES = 50_000


class _BoundedLoader(yaml.SafeLoader):
    """PyYAML's safe loader that refuses aliases, repeated keys, and what is too deep or too much."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases (*) are not read, write the value out", event.start_mark)
        self._depth += 1
        self._nodes += 1
        if self._depth > DEEPEST:
            raise _refusal(f"it is nested deeper than {DEEPEST} levels", event.start_mark)
        if self._nodes > MOST_NODES:
            raise _refusal(f"it has more than {MOST_NODES} values", event.start_mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_repeated_keys(node)
        return node


def _refusal(problem: str, mark: Any) -> yaml.YAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


def _refuse_repeated_keys(node: yaml.MappingNode) -> None:
    """Raise InputError for a key that stands twice in one mapping; YAML readers keep the last silently."""
    seen: set[str] = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            continue
        if key.value in seen:
            line = key.start_mark.line + 1
            raise InputError(f"key '{key.value}' stands twice (again in line {line}); keep one of them")
        seen.add(key.value)


def read_yaml(path: str | Path, what: str) -> Any:
    """Return what the YAML file ``path`` holds, of plain types only.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: no such file, too large, too deep, or not YAML; file, line and remedy are named.
    """
    try:
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(LARGEST + 1)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise InputError(
            f"{path}: cannot read the {what} file: {reason}; give the path of a YAML file"
        ) from None
    if len(text) > LARGEST:
        raise InputError(f"{path}: it has more than {LARGEST} characters: a {what} file is shorter")
    try:
        return yaml.load(text, Loader=_BoundedLoader)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" in line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "syntax error"
        raise InputError(f"{path}: not valid YAML{place}: {problem}; correct that line") from None
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        # What PyYAML makes of a value that looks like a date or carries a tag, e.g. 2020-99-99.
        raise InputError(f"{path}: not valid YAML: a value can't be read ({error}); correct it") from None
