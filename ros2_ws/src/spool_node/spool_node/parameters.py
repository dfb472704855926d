"""The declared table of parameters of a node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from spool_stream.errors import InputError

Value = bool | int | float | str | list[str] | list[float]

#: Declared by rclpy itself, so allowed in every parameter file.
BUILT_IN = ("use_sim_time", "start_type_description_service", "qos_overrides")


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its name, default (which fixes the type), meaning, unit and range.

    ``read_only`` parameters take effect when the node is started; the others may change while it runs.
    """

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` shows."""
        descriptor = ParameterDescriptor(name=self.name, read_only=self.read_only)
        descriptor.description = f"{self.description} [{self.unit}]" if self.unit else self.description
        if self.choices:
            descriptor.additional_constraints = "one of: " + ", ".join(self.choices)
        low = self.minimum if self.minimum is not None else None
        high = self.maximum if self.maximum is not None else None
        if low is None and high is None:
            return descriptor
        if isinstance(self.default, int) and not isinstance(self.default, bool):
            descriptor.integer_range = [
                IntegerRange(
                    from_value=int(low if low is not None else -(2**62)),
                    to_value=int(high if high is not None else 2**62),
                )
            ]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(
                    from_value=low if low is not None else -1.0e300,
                    to_value=high if high is not None else 1.0e300,
                )
            ]
        return descriptor

    def refusal(self, value: object) -> str | None:
        """Return why ``value`` can't be taken, or ``None``. Types and ranges are rclpy's to check."""
        if self.choices and value not in self.choices:
            return f"{self.name}: {value!r} is not one of {', '.join(self.choices)}"
        return None


def declare(node: Node, table: Sequence[Parameter], overrides: Mapping[str, Any]) -> None:
    """Declare ``table`` on ``node``; ``overrides`` are the values it was started with.

    Raises:
        InputError: an override is unknown, of the wrong type or out of range; the key's path is named.

    """
    path = f"{node.get_fully_qualified_name()}: parameter "
    known = {parameter.name for parameter in table}
    for name in overrides:
        if name not in known and name.split(".")[0] not in BUILT_IN:
            raise InputError(f"{path}{name} is unknown; this node has: {', '.join(sorted(known))}")
    for parameter in table:
        try:
            node.declare_parameter(parameter.name, parameter.default, parameter.descriptor())
        except InvalidParameterTypeException as error:
            raise InputError(
                f"{path}{parameter.name} must be of type {type(parameter.default).__name__}, "
                f"e.g. {parameter.default!r}"
            ) from error
        except InvalidParameterValueException as error:
            bounds = f"from {parameter.minimum} to {parameter.maximum} {parameter.unit}".strip()
            given = overrides[parameter.name].value
            raise InputError(f"{path}{parameter.name} = {given!r} is out of range ({bounds})") from error
        refusal = parameter.refusal(node.get_parameter(parameter.name).value)
        if refusal is not None:
            raise InputError(path + refusal)
