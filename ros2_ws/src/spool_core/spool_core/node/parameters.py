"""Parameters of a node: the declared table."""

from __future__ import annotations

import json
import math
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from spool_core.errors import InputError
from spool_core.events.language import LANGUAGES
from spool_core.events.sentences import VARIABLE
from spool_core.files import load_yaml, names_node, parameters_of, refuse_other_kind, sections_of
from spool_core.system import expanded

Value = bool | int | float | str | list[str] | list[float]

#: Declared by rclpy itself, so allowed in every parameter file.
BUILT_IN = ("use_sim_time", "start_type_description_service")
#: Would be accepted by rclpy and, for publishers and subscriptions that don't ask for them, ignored.
QOS_OVERRIDES = "qos_overrides"

#: Options of ROS 2 that a rule follows, which may be for the nodes of one name.
RULES = ("-p", "--param", "-r", "--remap")
_FOR_A_NODE = re.compile(r"([\w/*]+):(?!=)(.+:=.*)", re.DOTALL)
#: Sections that a message names: chosen, it stays a line.
MOST_NAMED = 5

#: Types in the words of ROS 2.
_TYPES: Mapping[type, str] = {bool: "bool", int: "integer", float: "double", str: "string"}


@dataclass(frozen=True, slots=True)
class NodeParameter:
    """Setting of a node: its name, default (which fixes the type), meaning, unit and range.

    ``read_only`` ones take effect at the process's start, ``structural`` ones when the node is configured:
    they may change while it is unconfigured. All others may change at any time. Setting the present value
    again is never refused, so that a whole parameter file can be loaded into a running node.
    """

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False
    structural: bool = False

    @property
    def type_name(self) -> str:
        """The type in the words of ROS 2, e.g. ``double``, ``string_array``."""
        if isinstance(self.default, list):
            return f"{_TYPES[type(self.default[0])]}_array"
        return _TYPES[type(self.default)]

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` shows."""
        descriptor = ParameterDescriptor(name=self.name)
        descriptor.description = f"{self.description} [{self.unit}]" if self.unit else self.description
        constraints = ["one of: " + ", ".join(self.choices)] if self.choices else []
        if self.read_only:
            constraints.append("fixed at start")
        if self.structural:
            constraints.append("changes only while unconfigured")
        descriptor.additional_constraints = "; ".join(constraints)
        if self.minimum is None and self.maximum is None:
            return descriptor
        whole = isinstance(self.default, int) and not isinstance(self.default, bool)
        most = 2**62 if whole else 1.0e300
        low = self.minimum if self.minimum is not None else -most
        high = self.maximum if self.maximum is not None else most
        if whole:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        return descriptor

    @property
    def bounds(self) -> str:
        """The range in words, e.g. ``from 0.01 to 10.0 N``."""
        return f"from {self.minimum} to {self.maximum} {self.unit}".strip()

    def read(self, value: Any) -> Value:
        """Return ``value``, as a parameter file holds it, as the node takes it.

        Raises:
            ValueError: the type is wrong, or the value out of range; the message names the parameter.
        """
        kind = type(self.default[0]) if isinstance(self.default, list) else type(self.default)
        values = value if isinstance(self.default, list) and isinstance(value, list) else [value]
        if kind is float:  # YAML 1.1 reads 15e-6 as text, ROS 2 as a number
            values = [_number(one) for one in values]
        if isinstance(self.default, list) != isinstance(value, list) or {type(one) for one in values} - {
            kind
        }:
            example = float(value) if kind is float and type(value) is int else self.default
            raise ValueError(f"{self.name} = {value!r} must be of type {self.type_name}, e.g. {example!r}")
        low = self.minimum if self.minimum is not None else -math.inf
        high = self.maximum if self.maximum is not None else math.inf
        if kind in (int, float) and not all(low <= one <= high for one in values):
            raise ValueError(f"{self.name} = {value!r} is out of range ({self.bounds})")
        refused = self.refusal(value)
        if refused is not None:
            raise ValueError(refused)
        return values if isinstance(self.default, list) else values[0]

    def refusal(self, value: object) -> str | None:
        """Return why ``value`` can't be taken, or ``None``. Types and ranges are rclpy's to check."""
        if self.choices and value not in self.choices:
            return f"{self.name}: {value!r} is not one of {', '.join(self.choices)}"
        return None


#: Of every node that composes sentences.
LANGUAGE = NodeParameter(
    "language", "", f"Language of messages; empty: value of {VARIABLE}, else English.",
    choices=("", *LANGUAGES), structural=True,
)  # fmt: skip


def declare(node: Node, table: Sequence[NodeParameter], overrides: Mapping[str, Any]) -> None:
    """Declare ``table`` on ``node``; ``overrides`` are the values it was started with.

    Raises:
        InputError: an override is unknown, of the wrong type or out of range; the key's path is named.

    """
    path = f"{node.get_fully_qualified_name()}: parameter "
    _refuse_unknown(table, overrides, path)
    for parameter in table:
        try:
            node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())
        except InvalidParameterTypeException as error:
            raise InputError(path + _wrong_type(parameter, overrides[parameter.name].value)) from error
        except InvalidParameterValueException as error:
            given = overrides[parameter.name].value
            out = f"{parameter.name} = {given!r} is out of range ({parameter.bounds})"
            raise InputError(path + out) from error
        refusal = parameter.refusal(node.get_parameter(parameter.name).value)
        if refusal is not None:
            raise InputError(path + refusal)


def rule(name: str, value: Value) -> list[str]:
    """Return the arguments that set the parameter ``name``; text that looks like a number stays text."""
    return ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]


def _wrong_type(parameter: NodeParameter, given: Any) -> str:
    name = parameter.name
    # The text that this process was started with as its value.
    found = reversed([word.partition(":=") for word in sys.argv])
    text = next((text for key, mark, text in found if mark and key.split(":")[-1] == name), None)
    wanted = _converted(given, parameter.default, text)
    said = f"{name} must be of type {parameter.type_name}, not {text or given!r}"
    if wanted is None:
        return f"{said}; an example is {' '.join(map(shlex.quote, rule(name, parameter.default)))}"
    if text is None:
        value = json.dumps(wanted, ensure_ascii=False)
        return f"{said}; write {name}: {value} in the parameter file"
    return f"{said}; type {' '.join(map(shlex.quote, rule(name, wanted)))}"


def _converted(given: Any, default: Value, text: str | None) -> Value | None:
    """Return ``given`` in the type of ``default``, ``None`` where it has no such meaning.

    Args:
        given: what the middleware made of the text.
        default: of the parameter.
        text: as it was typed, where that is known: 007 is text that a number would shorten.
    """
    if isinstance(default, list):
        entries = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
        converted = [_converted(entry, default[0], None) for entry in entries]
        return None if None in converted else converted  # type: ignore[return-value]  # of one type
    if isinstance(default, str):
        plain = given if isinstance(given, str) else json.dumps(given)
        return text if text is not None else plain
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        return None
    if isinstance(default, bool):
        return bool(given) if given in (0, 1) else None
    if isinstance(default, float):
        return float(given)
    return int(given) if given == int(given) else None


def refuse_other_files(arguments: Sequence[str]) -> None:
    """Refuse a file given as --params-file in ``arguments`` whose content shows another kind of file.

    Whatever else is wrong with it is rcl's to report.

    Raises:
        InputError: the file and its kind are named.

    """
    for flag, file in pairwise(arguments):
        if flag != "--params-file":
            continue
        try:
            content = load_yaml(expanded(file).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        refuse_other_kind(file, content, "parameters")


def refuse_other_nodes(arguments: Sequence[str], node: str, hosted: Sequence[str] = ()) -> list[str]:
    """Refuse what ``arguments`` set for other nodes alone: ``node``, a full name, would run on defaults.

    Args:
        arguments: of the process.
        node: its own node, for which rules are.
        hosted: nodes for which parameter files may be as well.

    Returns:
        Lines about sections that are for none of them, beside others that are.

    Raises:
        InputError: a parameter file has sections, and none for these nodes; or a rule names another node.

    """
    doubts: list[str] = []
    nodes, name = (node, *hosted), node.rpartition("/")[2]
    kinds = dict.fromkeys(one.rpartition("/")[2] for one in hosted or nodes)
    for flag, word in pairwise(arguments):
        sections = sections_of(word) if flag == "--params-file" else []
        other = [one for one in sections if not any(names_node(one, each) for each in nodes)]
        if other and len(other) == len(sections):
            who = f"{node} and the nodes that it hosts" if hosted else node
            ways = " or ".join(f"/**/{one}" for one in kinds) + ("" if hosted else f" (or {node})")
            raise InputError(
                f"{word}: no parameters for {who} in it, only for {', '.join(other[:MOST_NAMED])}: "
                f"write a section {ways}, or start the node without this file"
            )
        meant = [one for one in other if hosted and one.rpartition("/")[2] in kinds]
        doubts += [f"{word}: section {one} matches no node here" for one in meant]
        rule = _FOR_A_NODE.match(word) if flag in RULES else None
        if rule and rule[1] != name and not names_node(rule[1], node):
            way = f"type {flag} {rule[2]}"
            if rule[1].rpartition("/")[2] in kinds and hosted:
                way = f"write a parameter file with a section /**/{rule[1].rpartition('/')[2]}"
            raise InputError(f"{flag} {word}: it is for a node {rule[1]}, and this is {node}: {way}")
    return doubts


def read_parameters(file: str | Path, node: str, table: Sequence[NodeParameter]) -> dict[str, Value]:
    """Return the parameters that ``file`` gives the node of full name ``node``, without the node.

    Raises:
        InputError: the node would refuse the file; the reason names file, node and parameter.

    """
    path = f"{file}: {node}: parameter "
    given = parameters_of(file, node)
    _refuse_unknown(table, given, path)
    try:
        return {one.name: one.read(given[one.name]) for one in table if one.name in given}
    except ValueError as error:
        raise InputError(f"{path}{error}") from None


#: Parameters of earlier versions, and what to write in their place.
REMOVED = {
    "method": "the estimator has one method, the model that runs in parallel: remove the line",
    "forgetting": "the estimator forgets exponentially: remove the line and set memory, the time constant",
    "bags": "a waterfall begins when its page is opened: remove the line",
}


def _refuse_unknown(table: Sequence[NodeParameter], given: Iterable[str], path: str) -> None:
    known = {parameter.name for parameter in table}
    for name in given:
        if name.split(".")[0] == QOS_OVERRIDES:
            raise InputError(f"{path}{name}: quality of service is fixed, remove {QOS_OVERRIDES}")
        if name in REMOVED and name not in known:
            raise InputError(f"{path}{name} no longer exists: {REMOVED[name]}")
        if name not in known and name.split(".")[0] not in BUILT_IN:
            raise InputError(f"{path}{name} is unknown; this node has: {', '.join(sorted(known))}")


def _number(value: Any) -> Any:
    """Return text that is a number as that number, and all else as it is."""
    if not isinstance(value, str):
        return value
    try:
        return float(value)
    except ValueError:
        return value
