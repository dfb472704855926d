"""Message of a valve's description, and back."""

from __future__ import annotations

import math

from spool_msgs.msg import ValveDescription
from spool_sim.valve.description import Valve, valve_from_mapping

_NUMBERS = tuple(name for name in Valve.model_fields if name not in ("id", "oil"))


def to_description(valve: Valve) -> ValveDescription:
    """Return ``valve`` as a message, NaN for what is not known; the stamp is the caller's."""
    given = valve.given
    message = ValveDescription(oil=valve.oil or "", **{name: given.get(name, math.nan) for name in _NUMBERS})
    message.header.frame_id = valve.id
    return message


def from_description(message: ValveDescription) -> Valve:
    """Return the valve that ``message`` describes.

    Raises:
        InputError: a value is out of range; the key is named.

    """
    numbers = {name: getattr(message, name) for name in _NUMBERS}
    mapping = {name: value for name, value in numbers.items() if not math.isnan(value)}
    return valve_from_mapping(
        {"id": message.header.frame_id, "oil": message.oil or None, **mapping}, "valve description"
    )
