"""List of valves: the YAML file that says which valves there are, and how they are spread over processes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spool_core.errors import InputError
from spool_core.files import read_yaml


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
    if not Path(path).is_file():
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
        raise InputError(f"{path}: a namespace stands twice, valves must not mix")
    return valves


def share(valves: list[ListedValve], number: int, processes: int) -> list[ListedValve]:
    """Return the valves of process ``number`` of so many: every so-manieth one."""
    return valves[number::processes]
