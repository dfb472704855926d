"""Client of a node's parameters, through the services that every ROS 2 node has: list, get, set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rich.console import Console
from rich.table import Table
from spool_core.errors import InputError
from spool_core.files.yaml_file import YamlError, load_yaml
from spool_core.node.parameters import BUILT_IN
from spool_core.text.suggestion import did_you_mean

from .service_client import call, client_node

#: Field of a value and Python type, by the type of a parameter.
_FIELDS: dict[int, tuple[str, type, str]] = {
    ParameterType.PARAMETER_BOOL: ("bool_value", bool, "true or false"),
    ParameterType.PARAMETER_INTEGER: ("integer_value", int, "a whole number"),
    ParameterType.PARAMETER_DOUBLE: ("double_value", float, "a number"),
    ParameterType.PARAMETER_STRING: ("string_value", str, "text"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string_array_value", list, "a list of texts, e.g. [a, b]"),
}


def list_parameters(valve: str, name: str, only: str | None = None) -> None:
    """Print the parameters of the node ``name`` of ``valve``, or the one called ``only``.

    Raises:
        InputError: no such node answers, or it has no such parameter.
    """
    server = f"{valve}/{name}"
    with client_node("spool_param", valve) as node:
        names = _names(node, server)
        if only is not None:
            _check(server, only, names)
            names = [only]
        values, descriptors = _values(node, server, names)
    table = Table("parameter", "value", "range", "meaning", box=None, pad_edge=False)
    for value, descriptor in zip(values, descriptors, strict=True):
        table.add_row(
            descriptor.name, _text(value), _range(descriptor),
            "; ".join(filter(None, (descriptor.description, descriptor.additional_constraints))),
        )  # fmt: skip
    console = Console(highlight=False, markup=False)
    (console if console.is_terminal else Console(highlight=False, markup=False, width=200)).print(table)


def set_parameters(valve: str, name: str, changes: Sequence[str]) -> None:
    """Set parameters of the node ``name`` of ``valve``, ``changes`` being NAME=VALUE each, all or none.

    Raises:
        InputError: no such node answers, a change cannot be read, or the node refuses; its reason is given.
    """
    server = f"{valve}/{name}"
    wanted = dict(_split(change) for change in changes)
    with client_node("spool_param", valve) as node:
        names = _names(node, server)
        for one in wanted:
            _check(server, one, names)
        before, _ = _values(node, server, list(wanted))
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name=one, value=_read(one, text, old.type))
                for (one, text), old in zip(wanted.items(), before, strict=True)
            ]
        )
        result = call(node, server, "set_parameters_atomically", request, SetParametersAtomically).result
        if not result.successful:
            raise InputError(f"{server}: {' '.join(result.reason.split())}")
        after, _ = _values(node, server, list(wanted))
    for one, old, new in zip(wanted, before, after, strict=True):
        print(f"{server}: {one} was {_text(old)}, is {_text(new)}")
    print("This holds until the node ends. Write it to the node's parameter file to keep it.")


def _split(change: str) -> tuple[str, str]:
    name, mark, text = change.partition("=")
    name, text = name.strip().removesuffix(":"), text.strip()
    if not (mark and name and text):
        raise InputError(f"{change}: write NAME=VALUE, e.g. coulomb_change=0.2")
    return name, text


def _names(node: Node, server: str) -> list[str]:
    """Return the names of the node's own parameters."""
    names = call(node, server, "list_parameters", ListParameters.Request(), ListParameters).result.names
    return sorted(one for one in names if one.split(".")[0] not in BUILT_IN)


def _check(server: str, name: str, names: Sequence[str]) -> None:
    if name not in names:
        instead = did_you_mean(name, names) or f"; it has: {', '.join(names)}"
        raise InputError(f"{server}: no parameter {name}{instead}")


def _values(
    node: Node, server: str, names: Sequence[str]
) -> tuple[list[ParameterValue], list[ParameterDescriptor]]:
    values = call(node, server, "get_parameters", GetParameters.Request(names=names), GetParameters).values
    request = DescribeParameters.Request(names=names)
    return values, call(node, server, "describe_parameters", request, DescribeParameters).descriptors


def _read(name: str, text: str, kind: int) -> ParameterValue:
    """Return ``text`` as a value of the type ``kind``, as ROS 2 reads it."""
    if kind not in _FIELDS:
        raise InputError(f"{name}: parameters of this type are set in the parameter file only")
    attribute, wanted, meant = _FIELDS[kind]
    try:
        value: Any = text if wanted is str else float(text) if wanted is float else load_yaml(text)
    except (ValueError, YamlError):
        value = None
    texts = not isinstance(value, list) or all(isinstance(one, str) for one in value)
    if type(value) is not wanted or not texts:
        raise InputError(f"{name}={text}: give {meant}")
    return ParameterValue(type=kind, **{attribute: value})


def _text(value: ParameterValue) -> str:
    return str(parameter_value_to_python(value))


def _range(descriptor: ParameterDescriptor) -> str:
    for one in (*descriptor.floating_point_range, *descriptor.integer_range):
        return f"{one.from_value:g} to {one.to_value:g}"
    return ""
