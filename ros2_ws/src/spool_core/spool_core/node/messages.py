"""Conversion between messages and the types of the cores."""

from __future__ import annotations

import array

import numpy as np
from builtin_interfaces.msg import Time
from spool_msgs.msg import AccelerationBlock
from spool_msgs.msg import Quantity as QuantityMessage

from spool_core.block import Block
from spool_core.uncertainty import Quantity, Validity

NANOSECONDS = 1_000_000_000


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
