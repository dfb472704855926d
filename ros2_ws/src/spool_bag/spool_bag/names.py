"""Names of valves: ROS namespaces without the leading slash."""

from __future__ import annotations

import re

from spool_core.errors import InputError

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def check_valve(valve: str) -> None:
    """Raise InputError unless ``valve`` can be a ROS namespace."""
    if not _NAME.fullmatch(valve) or "__" in valve:
        raise InputError(
            f"valve name {valve!r}: use letters, digits and single underscores, not a digit first"
        )
