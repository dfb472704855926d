"""Conversion between messages and the types of the cores."""

from __future__ import annotations

import array
from enum import IntEnum
from importlib import import_module
from typing import Any, TypeVar

import numpy as np
from builtin_interfaces.msg import Time
from spool_msgs.msg import AccelerationBlock, HealthEvent
from spool_msgs.msg import Quantity as QuantityMessage

from spool_core.block import Block
from spool_core.errors import InputError
from spool_core.events.event import Event, EventState, Facts, Severity, Urgency
from spool_core.events.language import Language
from spool_core.events.sentences import headline
from spool_core.uncertainty import Quantity, Validity

NANOSECONDS = 1_000_000_000

#: Fields that an event's facts and its message share as they are.
_SAME = (
    "parameter", "unit", "value", "low", "high", "baseline", "change", "limit", "false_alarm_interval",
    "time_to_limit", "advice", "subject", "note",
)  # fmt: skip

Number = TypeVar("Number", bound=IntEnum)


def to_block(message: AccelerationBlock) -> Block:
    """Return the message's samples without copying them."""
    return Block(
        stamp=nanoseconds(message.header.stamp),
        sequence=message.sequence,
        sample_period=message.sample_period,
        body=np.frombuffer(message.body, dtype=np.float32),
        spool=np.frombuffer(message.spool, dtype=np.float32),
        source=message.header.frame_id,
    )


def from_block(block: Block, valve_id: str) -> AccelerationBlock:
    """Return ``block`` as a message of the valve ``valve_id``."""
    message = AccelerationBlock(sequence=block.sequence, sample_period=block.sample_period)
    message.header.frame_id = valve_id
    message.header.stamp = to_time(block.stamp)
    message.body = array.array("f", np.ascontiguousarray(block.body, dtype=np.float32).tobytes())
    message.spool = array.array("f", np.ascontiguousarray(block.spool, dtype=np.float32).tobytes())
    return message


def type_with(name: str, field: str) -> Any:
    """Return the message type ``name`` (``package/msg/Name``), which has ``field``: see :func:`number_of`.

    Raises:
        InputError: it is not installed, or has no such field.
    """
    package, _, kind = name.partition("/msg/")
    try:
        found = getattr(import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError, ValueError):
        raise InputError(f"{name!r} is no package/msg/Name here: source its workspace") from None
    try:
        number_of(found(), field)
    except IndexError:
        return found  # of an array that is empty until it is sent
    except (AttributeError, TypeError, ValueError):
        fields = ", ".join(found.get_fields_and_field_types())
        raise InputError(f"{name} has no number {field!r}; it has: {fields}") from None
    return found


def number_of(message: Any, field: str) -> float:
    """Return the number at ``field`` of ``message``, e.g. ``currents[2]`` or ``valves[0].current``.

    Raises:
        AttributeError, IndexError, TypeError, ValueError: there is no number.
    """
    for part in field.replace("[", ".[").split("."):
        message = message[int(part[1:].removesuffix("]"))] if part[:1] == "[" else getattr(message, part)
    return float(message)


def nanoseconds(time: Time) -> int:
    """Return a message's time in integer ns."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def to_time(stamp: int) -> Time:
    """Return integer ns as a message's time."""
    seconds, rest = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def to_quantity(quantity: Quantity) -> QuantityMessage:
    """Return ``quantity`` as a message."""
    return QuantityMessage(
        name=quantity.name,
        unit=quantity.unit,
        value=float(quantity.value),
        standard_deviation=float(quantity.standard_deviation),
        validity=int(quantity.validity),
    )


def from_quantity(message: QuantityMessage) -> Quantity:
    """Return the message's quantity; an unknown validity counts as unknown."""
    known = message.validity in set(Validity)
    return Quantity(
        message.name,
        message.unit,
        message.value,
        message.standard_deviation,
        Validity(message.validity) if known else Validity.UNKNOWN,
    )


def to_event_message(event: Event, valve_id: str, language: Language) -> HealthEvent:
    """Return ``event`` of the valve ``valve_id`` as a message with its headline in ``language``."""
    facts = event.facts
    message = HealthEvent(
        kind=event.kind,
        cause=event.cause,
        state=int(event.state),
        severity=int(event.severity),
        quantity=to_quantity(event.quantity),
        message=event.text or headline(event, language),
        source=event.source,
        code=event.code,
        began=to_time(facts.began),
        causes=list(facts.causes),
        probabilities=array.array("d", facts.probabilities),
        urgency=int(facts.urgency),
        evidence=[to_quantity(one) for one in facts.evidence],
        **{name: getattr(facts, name) for name in _SAME},
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(event.stamp)
    return message


def from_event_message(message: Any) -> Event:
    """Return the event of a ``HealthEvent``, also of one that was recorded by an earlier version.

    Args:
        message: as rclpy or rosbags read it. Fields that it lacks are unknown; an event without a parameter
            keeps the sentence that it came with.
    """
    known = getattr(message, "parameter", "") != ""
    facts = Facts()
    if known:
        facts = Facts(
            began=nanoseconds(message.began),
            causes=tuple(message.causes),
            probabilities=tuple(float(one) for one in message.probabilities),
            urgency=_member(Urgency, message.urgency),
            evidence=tuple(from_quantity(one) for one in message.evidence),
            **{name: getattr(message, name) for name in _SAME},
        )
    return Event(
        nanoseconds(message.header.stamp),
        message.kind,
        _member(EventState, message.state),
        _member(Severity, message.severity),
        message.cause,
        from_quantity(message.quantity),
        getattr(message, "source", ""),
        getattr(message, "code", 0),
        facts,
        "" if known else message.message,
    )


def _member(numbers: type[Number], value: int) -> Number:
    """Return the member with this number; one of a later version counts as unknown."""
    return numbers(value) if value in set(numbers) else numbers(0)
