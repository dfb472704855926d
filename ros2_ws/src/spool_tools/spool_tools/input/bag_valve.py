"""Valve description in a bag."""

from __future__ import annotations

import math
from itertools import islice

from spool_bag.format.definitions import typestore
from spool_bag.reading.reader import BagReader
from spool_sim.valve.description import Valve, valve_from_mapping

VALVE_DESCRIPTION = "spool_msgs/msg/ValveDescription"

_NUMBERS = tuple(name for name in Valve.model_fields if name not in ("id", "oil"))


def encode_valve(valve: Valve, stamp: int) -> bytes:
    """Return the CDR of ``valve``'s description, published at ``stamp`` (ns)."""
    types = typestore().types
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    message = types[VALVE_DESCRIPTION](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id=valve.id),
        oil=valve.oil or "",
        **{name: valve.given.get(name, math.nan) for name in _NUMBERS},
    )
    return bytes(typestore().serialize_cdr(message, VALVE_DESCRIPTION))


def recorded_valve(reader: BagReader, name: str) -> Valve | None:
    """Return the last description of valve ``name`` in the bag, ``None`` without any."""
    topic = f"/{name}/valve"
    if topic not in reader.topics:
        return None
    last = None
    # The last one counts; behind it the bag is not read.
    for last in islice(reader.messages(topic), reader.topics[topic].messages):  # noqa: B007
        pass
    if last is None:
        return None
    numbers = {key: getattr(last, key) for key in _NUMBERS}
    mapping = {key: value for key, value in numbers.items() if not math.isnan(value)}
    where = f"{reader.path}: {topic}"
    return valve_from_mapping({"id": last.header.frame_id, "oil": last.oil or None, **mapping}, where)
