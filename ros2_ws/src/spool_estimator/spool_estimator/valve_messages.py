"""Message of a valve's description, and back."""

from __future__ import annotations

from spool_msgs.msg import ValveDescription
from spool_sim.valve.description import Valve, valve_from_mapping

_NUMBERS = tuple(name for name in Valve.model_fields if name not in ("id", "oil"))


def to_description(valve: Valve) -> ValveDescription:
    """Return ``valve`` as a message; the stamp is the caller's."""
    message = ValveDescription(oil=valve.oil or "", **{name: getattr(valve, name) for name in _NUMBERS})
    message.header.frame_id = valve.id
    return message


def from_description(message: ValveDescription) -> Valve:
    """Return the valve that ``message`` describes.

    Raises:
        InputError: a value is out of range; the key is named.

    """
    mapping = {name: getattr(message, name) for name in _NUMBERS}
    return valve_from_mapping(
        {"id": message.header.frame_id, "oil": message.oil or None, **mapping}, "valve description"
    )
