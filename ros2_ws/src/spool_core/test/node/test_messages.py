from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.block import Block
from spool_core.node.messages import from_block, from_quantity, nanoseconds, to_block, to_quantity, to_time
from spool_core.uncertainty import Quantity, Validity
from spool_msgs.msg import AccelerationBlock
from spool_msgs.msg import Quantity as QuantityMessage

SAMPLES = st.lists(st.floats(width=32), max_size=20)


@given(
    stamp=st.integers(0, 2**31 * 10**9 - 1),
    sequence=st.integers(0, 2**64 - 1),
    period=st.floats(),
    body=SAMPLES,
    spool=SAMPLES,
)
def test_a_block_survives_the_wire_bit_for_bit(
    stamp: int, sequence: int, period: float, body: list[float], spool: list[float]
) -> None:
    block = Block(stamp, sequence, period, np.array(body, np.float32), np.array(spool, np.float32))
    message = deserialize_message(serialize_message(from_block(block, "valve_1")), AccelerationBlock)
    assert message.header.frame_id == "valve_1"
    back = to_block(message)
    assert (back.stamp, back.sequence) == (stamp, sequence)
    assert np.float64(back.sample_period).tobytes() == np.float64(period).tobytes()
    assert back.body.tobytes() == block.body.tobytes()
    assert back.spool.tobytes() == block.spool.tobytes()


def test_samples_that_are_not_contiguous_are_sent_in_order() -> None:
    every_second = np.arange(10, dtype=np.float32)[::2]
    message = from_block(Block(1, 0, 1e-3, every_second, every_second), "valve_1")
    assert list(message.body) == [0.0, 2.0, 4.0, 6.0, 8.0]


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_are_whole_nanoseconds(stamp: int) -> None:
    assert nanoseconds(to_time(stamp)) == stamp


@pytest.mark.parametrize("validity", Validity)
def test_a_quantity_survives(validity: Validity) -> None:
    quantity = Quantity("coulomb_force", "N", 0.5, 0.01, validity)
    assert from_quantity(to_quantity(quantity)) == quantity


def test_an_unknown_quantity_stays_not_a_number() -> None:
    message = to_quantity(Quantity("coulomb_force", "N"))
    assert math.isnan(message.value)
    assert math.isnan(message.standard_deviation)
    assert message.validity == QuantityMessage.VALIDITY_UNKNOWN


def test_a_validity_of_a_later_release_counts_as_unknown() -> None:
    message = QuantityMessage(name="coulomb_force", unit="N", value=0.5, validity=250)
    assert from_quantity(message).validity is Validity.UNKNOWN
