"""ROS arguments of a host: which of them each of its processes and each hosted node gets."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import yaml
from spool_core.files import LARGEST, YamlError, load_yaml

#: Name of the node of a host's first process; that of process 1 is ``host_1``, and so on.
NAME = "host"
_PARAMETERS = "ros__parameters"
_FILE, _PARAMETER, _REMAP = ("--params-file",), ("-p", "--param"), ("-r", "--remap")
#: Rule that names the node, of any node or of one only.
_NAMING = re.compile(r"^(?:[^:=]*:)?__(?:node|name):=(.+)$")


def node_name(number: int) -> str:
    """Return the name of the node of process ``number``."""
    return NAME if number == 0 else f"{NAME}_{number}"


def arguments_of_process(arguments: Sequence[str], number: int) -> list[str]:
    """Return the arguments with which process ``number`` of a host starts.

    What is meant for the host's node, a section of a parameter file or a rule of its own, holds for the node
    of each process.
    """
    if number == 0:
        return list(arguments)
    words = list(arguments)
    base = next((found for found in map(_given_name, _pairs(words)) if found), NAME)
    for at, (before, word) in enumerate(_pairs(arguments), 1):
        if before in _FILE:
            words[at] = _copied(word, base, f"{base}_{number}")
        elif before in _REMAP and _NAMING.match(word):
            words[at] = f"{word}_{number}"
        elif before in _PARAMETER:
            words[at] = re.sub(rf"^((?:.*/)?){re.escape(base)}:(?!=)", rf"\g<1>{base}_{number}:", word)
    return words


def arguments_of_nodes(arguments: Sequence[str]) -> list[str]:
    """Return what the hosted nodes get: the parameter files. The rest is for the host's node alone."""
    return [word for pair in _pairs(arguments) if pair[0] in _FILE for word in pair]


def names_for_all(arguments: Sequence[str]) -> set[str]:
    """Return the parameters in sections for nodes of every name, such as ``/**``, of the parameter files."""
    found: set[str] = set()
    for before, path in _pairs(arguments):
        if before in _FILE and (root := _composed(path)) is not None:
            for key, section in _sections(root):
                if _split(key)[1] in ("*", "**"):
                    found |= {name.value.split(".")[0] for name, _ in section.value}
    return found


def _pairs(words: Sequence[str]) -> Iterator[tuple[str, str]]:
    return pairwise(words)


def _given_name(pair: tuple[str, str]) -> str | None:
    match = _NAMING.match(pair[1])
    return match[1] if match and pair[0] in _REMAP else None


def _split(key: str) -> tuple[str, str]:
    """Return the namespace with its slash, and the name, of a section."""
    at = key.rfind("/") + 1
    return key[:at], key[at:]


def _composed(path: str) -> yaml.MappingNode | None:
    """Return the YAML nodes of a parameter file; ``None`` for what is wrong: the middleware refuses it."""
    try:
        text = Path(path).read_text(encoding="utf-8")[: LARGEST + 1]
        load_yaml(text)
    except (OSError, UnicodeDecodeError, YamlError):
        return None
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    return root if isinstance(root, yaml.MappingNode) else None


def _sections(root: yaml.MappingNode) -> Iterator[tuple[str, yaml.MappingNode]]:
    """Yield the sections with their keys, those of nested namespaces included."""
    for key, value in root.value:
        if not isinstance(value, yaml.MappingNode):
            continue
        own = next((one for name, one in value.value if name.value == _PARAMETERS), None)
        if isinstance(own, yaml.MappingNode):
            yield key.value, own
        elif own is None:
            yield from _sections(value)


def _copied(path: str, base: str, name: str) -> str:
    """Return a copy of the parameter file in which sections for ``base`` stand for ``name`` as well.

    Sections for ``name`` itself come later, and so rule over them. The copy lives as long as this process.
    """
    root = _composed(path)
    if root is None or not any(_split(key)[1] == base for key, _ in _sections(root)):
        return path
    _double(root, base, name)
    file = os.memfd_create("parameters", 0)
    os.write(file, yaml.serialize(root, allow_unicode=True).encode())
    return f"/proc/self/fd/{file}"


def _double(mapping: yaml.MappingNode, base: str, name: str) -> None:
    for key, value in list(mapping.value):
        if not isinstance(value, yaml.MappingNode):
            continue
        if not any(inner.value == _PARAMETERS for inner, _ in value.value):
            _double(value, base, name)
        elif _split(key.value)[1] == base:
            own = _split(key.value)[0] + name
            keys = [one.value for one, _ in mapping.value]
            at = min(keys.index(one) + shift for one, shift in ((own, 0), (key.value, 1)) if one in keys)
            mapping.value.insert(at, (yaml.ScalarNode(key.tag, own), copy.deepcopy(value)))
