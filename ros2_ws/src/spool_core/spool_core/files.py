"""Files that people write: YAML with the place of each error, and files of parameters.

A few hundred bytes of YAML can stand for gigabytes, or end the stack.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from spool_core.errors import InputError
from spool_core.system import expanded
from spool_core.text import did_you_mean

#: Characters; the largest file that users write, a launch file's list of 1000 valves, has some 100 kB.
LARGEST = 1_000_000
#: Levels and values; users' files have 3 levels and a few hundred values, a bag's metadata nests 8 deep.
DEEPEST = 32
MOST_VALUES = 50_000

#: Key that marks the parameters of a node in a parameter file of ROS 2.
NODE_PARAMETERS = "ros__parameters"
#: Kinds of files that are recognised by their content, and where each belongs.
KINDS: Mapping[str, str] = {
    "valve": "a valve description: pass it as --valve to commands, as -p valve_file:= to nodes",
    "parameters": "a parameter file of nodes: pass it as --params-file to nodes and to `./spool replay`",
    "valves": "a list of valves: pass it as valves_file:= to the launch file or the host",
}
#: Keys that only a valve description has.
_OF_A_VALVE = {
    "moving_mass",
    "spool_mass",
    "spring_stiffness",
    "land_diameter",
    "land_length",
    "radial_clearance",
}

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
        # What would cost more than its size to compose is refused.
        depth = values = 0
        for event in yaml.parse(text, Loader=_Loader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            values += isinstance(event, yaml.NodeEvent)
            if isinstance(event, yaml.AliasEvent):
                raise _refusal("aliases (*) are not supported, write the value out", event)
            if depth > DEEPEST:
                raise _refusal(f"it is nested deeper than {DEEPEST} levels", event)
            if values > most_values:
                raise _refusal(f"it has more than {most_values} values", event)
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


def file_of(name_or_path: str | Path, what: str, known: Iterable[str]) -> Path:
    """Return the file that a user names in place of one of the ``known`` names of a ``what``.

    Raises:
        InputError: there is no such file; the known names are listed, and the nearest one is suggested.
    """
    path, names = expanded(name_or_path), list(known)
    if not path.exists():
        raise InputError(
            f"{path}: no such {what}; give one of {', '.join(names)} or a YAML file"
            f"{did_you_mean(str(path), names)}"
        )
    return path


def read_yaml(path: str | Path, what: str) -> Any:
    """Return what the YAML file ``path`` holds, of plain types only.

    Args:
        path: file to read.
        what: what the file describes, for the message ("valve", "excitation").

    Raises:
        InputError: no such file, as :func:`load_yaml`, or the file is another one of KINDS; file, line and
            remedy are named.
    """
    try:
        with expanded(path).open(encoding="utf-8") as file:
            text = file.read(LARGEST + 1)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise InputError(
            f"{path}: cannot read the {what} file: {reason}; give the path of a YAML file"
        ) from None
    try:
        content = load_yaml(text)
    except YamlError as error:
        raise InputError(f"{path}: {error}") from None
    refuse_other_kind(path, content, what)
    return content


def refuse_other_kind(path: str | Path, content: Any, what: str) -> None:
    """Refuse ``content`` of the file ``path`` if it is clearly another kind of file than ``what``.

    Raises:
        InputError: the kind is named, and where such a file belongs.
    """
    found = kind_of(content)
    if found is not None and found != what:
        raise InputError(f"{path}: this is {KINDS[found]}")


def kind_of(content: Any) -> str | None:
    """Return which of KINDS ``content`` is, ``None`` if no key shows it."""
    if isinstance(content, list):
        listed = bool(content) and all(isinstance(one, dict) and "namespace" in one for one in content)
        return "valves" if listed else None
    if not isinstance(content, dict):
        return None
    if _holds_parameters(content):
        return "parameters"
    return "valve" if _OF_A_VALVE & {key for key in content if isinstance(key, str)} else None


def parameters_of(path: str | Path, node: str) -> dict[str, Any]:
    """Return the parameters that the file ``path`` gives ``node``, its full name, e.g. ``/valve_1/monitor``.

    Sections apply in the order of the file, as rclpy applies them: of two values the later one counts. In the
    name of a section ``*`` stands for one part of a node's name and ``**`` for any number of parts.

    Raises:
        InputError: as :func:`read_yaml`, or the file has no section of parameters.
    """
    content = read_yaml(path, "parameters")
    sections = list(_sections(content, "")) if isinstance(content, dict) else []
    if not sections:
        raise InputError(
            f"{path}: the file contains no node parameters: write a section such as /**/monitor with "
            f"{NODE_PARAMETERS}, as in config/valve.yaml"
        )
    given: dict[str, Any] = {}
    for name, values in sections:
        if not isinstance(values, dict):
            raise InputError(f"{path}: {name}: {NODE_PARAMETERS} must be a list of 'name: value' lines")
        if names_node(name, node):
            given |= dict(_flat(values, ""))
    return given


def sections_of(path: str | Path) -> list[str]:
    """Return the names of the sections of a parameter file; none where it cannot be read."""
    try:
        content = load_yaml(expanded(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [name for name, _ in _sections(content, "")] if isinstance(content, dict) else []


def names_node(section: str, node: str) -> bool:
    """Return whether the name of a ``section`` stands for the full name of ``node``; for ``*`` see above."""
    pattern = re.escape(section).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(pattern, node) is not None


def _holds_parameters(content: dict[Any, Any]) -> bool:
    return NODE_PARAMETERS in content or any(
        _holds_parameters(one) for one in content.values() if isinstance(one, dict)
    )


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
                raise YamlError(f"duplicate key '{key.value}' (again in line {line}); keep one of them")
            seen.add(key.value)
        _refuse_repeated_keys(key)
        _refuse_repeated_keys(value)


def _short(problem: object) -> str:
    return " ".join(str(problem).split())[:200]


def _sections(content: dict[Any, Any], name: str) -> Iterator[tuple[str, Any]]:
    """Yield name and parameters of each section; a name may be spread over nested keys."""
    for key, value in content.items():
        if key == NODE_PARAMETERS:
            yield name, value
        elif isinstance(value, dict):
            yield from _sections(value, f"{name}/{str(key).strip('/')}")


def _flat(values: dict[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield parameters by their full names: nested keys are joined by dots."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
