"""Arguments of the host: which valves, from which list, on which middleware.

Fast DDS allocates 100 samples for each of the 30 end points of a node before the first one is sent: 1 MB of
2.3 MB that a managed node takes. A profile changes that (Fast DDS, "XML profiles", ``allocated_samples``).
"""

from __future__ import annotations

import atexit
import copy
import fcntl
import json
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import yaml
from spool_core.errors import InputError
from spool_core.files import LARGEST, YamlError, load_yaml, read_yaml
from spool_core.system import expanded

#: Name of the node of a host's first process; that of process 1 is ``host_1``, and so on.
NAME = "host"
_PARAMETERS = "ros__parameters"
_FILE, _PARAMETER, _REMAP = ("--params-file",), ("-p", "--param"), ("-r", "--remap")
#: Rule that names the node, of any node or of one only.
_NAMING = re.compile(r"^(?:[^:=]*:)?__(?:node|name):=(.+)$")

#: B that a list takes at most, which the reader of YAML bounds.
_LARGEST = 1 << 26

#: Profiles of Fast DDS that allocate little, and a document that holds no others.
PROFILES = """  <data_writer profile_name="spool_writer" is_default_profile="true">
   <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
   <topic><resourceLimitsQos><allocated_samples>1</allocated_samples></resourceLimitsQos></topic>
   <historyMemoryPolicy>DYNAMIC_REUSABLE</historyMemoryPolicy>
  </data_writer>
  <data_reader profile_name="spool_reader" is_default_profile="true">
   <qos><data_sharing><kind>OFF</kind></data_sharing></qos>
   <topic><resourceLimitsQos><allocated_samples>1</allocated_samples></resourceLimitsQos></topic>
   <historyMemoryPolicy>DYNAMIC_REUSABLE</historyMemoryPolicy>
  </data_reader>
"""
EMPTY = '<dds xmlns="http://www.eprosima.com"><profiles></profiles></dds>'
FILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")


def node_name(number: int) -> str:
    """Return the name of the node of process ``number``."""
    return NAME if number == 0 else f"{NAME}_{number}"


def arguments_of_process(arguments: Sequence[str], number: int) -> list[str]:
    """Return the arguments with which process ``number`` of a host starts.

    What is meant for the host's node, a section of a parameter file or a separate rule, holds for the node
    of each process.
    """
    if number == 0:
        return list(arguments)
    words = list(arguments)
    given = (_NAMING.match(word) for before, word in pairwise(words) if before in _REMAP)
    base = next((match[1] for match in given if match), NAME)
    for at, (before, word) in enumerate(pairwise(arguments), 1):
        if before in _FILE:
            words[at] = _copied(word, base, f"{base}_{number}")
        elif before in _REMAP and _NAMING.match(word):
            words[at] = f"{word}_{number}"
        elif before in _PARAMETER:
            words[at] = re.sub(rf"^((?:.*/)?){re.escape(base)}:(?!=)", rf"\g<1>{base}_{number}:", word)
    return words


def arguments_of_nodes(arguments: Sequence[str]) -> list[str]:
    """Return what the hosted nodes get: the parameter files. The rest is for the host's node alone."""
    return [word for pair in pairwise(arguments) if pair[0] in _FILE for word in pair]


def names_for_all(arguments: Sequence[str]) -> set[str]:
    """Return the parameters in sections for nodes of every name, such as ``/**``, of the parameter files."""
    found: set[str] = set()
    for before, path in pairwise(arguments):
        if before in _FILE and (root := _composed(path)) is not None:
            for key, section in _sections(root):
                if _split(key)[1] in ("*", "**"):
                    found |= {name.value.split(".")[0] for name, _ in section.value}
    return found


@dataclass(frozen=True, slots=True)
class ListedValve:
    """Valve of the list: its namespace, and its valve file where it has one."""

    namespace: str
    valve_file: str = ""


def read_valves(path: str) -> list[ListedValve]:
    """Return the valves of the list in the file ``path``.

    Raises:
        InputError: it is no file, no list of valves, or a namespace stands twice.
    """
    if not expanded(path).is_file():
        raise InputError(
            f"valves_file: {path} is no file: name the YAML file, e.g. a copy of config/valves.yaml"
        )
    entries = read_yaml(path, "valves")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: give a list of valves, each with a namespace")
    valves = []
    for number, entry in enumerate(entries, 1):
        if not isinstance(entry, dict) or "namespace" not in entry:
            raise InputError(f"{path}: entry {number} has no namespace")
        unknown = set(entry) - {"namespace", "valve_file"}
        if unknown:
            raise InputError(f"{path}: entry {number}: unknown key {min(map(str, unknown))}")
        namespace = str(entry["namespace"]).strip("/")
        valves.append(ListedValve(namespace, str(entry.get("valve_file", ""))))
    names = [valve.namespace for valve in valves]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: duplicate namespace: each valve needs its own")
    return valves


def share(valves: list[ListedValve], number: int, processes: int) -> list[ListedValve]:
    """Return the valves of process ``number`` of so many: every so-manieth one."""
    return valves[number::processes]


class FirstList:
    """First list of valves, shared by the processes of a host after a fork.

    A file that is edited meanwhile changes nothing until the host is started again: each process would take
    its share of another list, so that some valves had two estimators and some none.
    """

    def __init__(self) -> None:
        self._file = os.memfd_create("valves")

    def read(self, path: str) -> list[ListedValve]:
        """Return the list, read from ``path`` where no process has read it yet.

        Raises:
            InputError: as of :func:`~spool_bringup.host.arguments.read_valves`.
        """
        fcntl.lockf(self._file, fcntl.LOCK_EX)
        try:
            text = os.pread(self._file, _LARGEST, 0)
            if text:
                return [ListedValve(*one) for one in json.loads(text)]
            valves = read_valves(path)
            os.pwrite(self._file, json.dumps([[one.namespace, one.valve_file] for one in valves]).encode(), 0)
            return valves
        finally:
            fcntl.lockf(self._file, fcntl.LOCK_UN)


def economise() -> None:
    """Make the middleware of this process allocate little ahead and start no thread for each reader.

    With data sharing, which it would choose itself, each reader of messages of fixed size has a thread and
    shared memory: ten a valve. What a given file says of transports and participants holds beside it; a file
    with profiles of readers or writers is kept as it is.
    """
    given = next((os.environ[name] for name in FILES if name in os.environ), None)
    try:
        text = EMPTY if given is None else Path(given).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return  # the middleware names it
    if "</profiles>" not in text or "<data_writer" in text or "<data_reader" in text:
        return
    with tempfile.NamedTemporaryFile("w", prefix="spool_", suffix=".xml", delete=False) as stream:
        stream.write(text.replace("</profiles>", f"{PROFILES}</profiles>", 1))
    path = Path(stream.name)
    atexit.register(path.unlink, missing_ok=True)  # processes that are forked end without it
    for name in FILES:
        os.environ[name] = str(path)
    os.environ["RMW_FASTRTPS_USE_QOS_FROM_XML"] = "1"


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
