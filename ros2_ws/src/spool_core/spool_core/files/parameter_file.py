"""Parameter file of nodes, read without ROS: the values that a node of a given name takes from it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spool_core.errors import InputError

from .yaml_file import NODE_PARAMETERS, read_yaml


def parameters_of(path: str | Path, node: str) -> dict[str, Any]:
    """Return the parameters that the file ``path`` gives ``node``, its full name, e.g. ``/valve_1/monitor``.

    Sections apply in the order of the file, as rclpy applies them: of two values the later one counts. In the
    name of a section ``*`` stands for one part of a node's name and ``**`` for any number of parts.

    Raises:
        InputError: as :func:`~.yaml_file.read_yaml`, or the file has no section of parameters.
    """
    content = read_yaml(path, "parameters")
    sections = list(_sections(content, "")) if isinstance(content, dict) else []
    if not sections:
        raise InputError(
            f"{path}: no parameters of nodes in it: write a section such as /**/monitor with "
            f"{NODE_PARAMETERS}, as in config/valve.yaml"
        )
    given: dict[str, Any] = {}
    for name, values in sections:
        if not isinstance(values, dict):
            raise InputError(f"{path}: {name}: {NODE_PARAMETERS} must be a list of 'name: value' lines")
        if _matches(name, node):
            given |= dict(_flat(values, ""))
    return given


def _sections(content: dict[Any, Any], name: str) -> Iterator[tuple[str, Any]]:
    """Yield name and parameters of each section; a name may be spread over nested keys."""
    for key, value in content.items():
        if key == NODE_PARAMETERS:
            yield name, value
        elif isinstance(value, dict):
            yield from _sections(value, f"{name}/{str(key).strip('/')}")


def _matches(section: str, node: str) -> bool:
    pattern = re.escape(section).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(pattern, node) is not None


def _flat(values: dict[Any, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield parameters by their full names: nested keys are joined by dots."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
