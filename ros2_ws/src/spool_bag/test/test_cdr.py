from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from spool_bag.metadata import ACCELERATION_BLOCK, ACCELERATION_BLOCKS, TEMPERATURE, typestore
from spool_core.block import Block
from spool_core.cdr import (
    CdrError,
    OilTemperature,
    block_head,
    decode_block,
    decode_blocks,
    decode_temperature,
    encode_block,
    encode_temperature,
    header_stamp,
)

samples = hnp.arrays(np.float32, st.integers(0, 50), elements=st.floats(width=32, allow_nan=True))
stamps = st.integers(0, (2**31) * 10**9 - 1)
frame_ids = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12)
blocks = st.builds(
    Block,
    stamp=stamps,
    sequence=st.integers(0, 2**64 - 1),
    sample_period=st.floats(allow_nan=False),
    body=samples,
    spool=samples,
)


def message(block: Block, frame_id: str) -> Any:
    types = typestore().types
    seconds, nanoseconds = divmod(block.stamp, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
    header = types["std_msgs/msg/Header"](stamp, frame_id)
    return types[ACCELERATION_BLOCK](header, block.sequence, block.sample_period, block.body, block.spool)


def assert_same(got: Block | Any, expected: Block) -> None:
    assert got.sequence == expected.sequence
    assert got.sample_period == expected.sample_period
    np.testing.assert_array_equal(got.body, expected.body)
    np.testing.assert_array_equal(got.spool, expected.spool)


@given(blocks, frame_ids)
def test_encoding_is_what_rosbags_writes(block: Block, frame_id: str) -> None:
    reference = typestore().serialize_cdr(message(block, frame_id), ACCELERATION_BLOCK, little_endian=True)
    assert encode_block(block, frame_id) == bytes(reference)


@given(blocks, frame_ids, st.booleans())
def test_decoding_agrees_with_rosbags(block: Block, frame_id: str, little: bool) -> None:
    data = bytes(
        typestore().serialize_cdr(message(block, frame_id), ACCELERATION_BLOCK, little_endian=little)
    )
    got = decode_block(data)
    assert_same(got, block)
    assert_same(typestore().deserialize_cdr(data, ACCELERATION_BLOCK), got)
    assert got.stamp == header_stamp(data) == block.stamp
    assert block_head(data) == (block.sequence, block.stamp)
    assert got.body.dtype == np.dtype(np.float32)
    assert got.body.flags.aligned


def many(items: list[tuple[str, str, Block]], *, little: bool = True) -> bytes:
    """Return the CDR of one message with names, ids and blocks."""
    names, blocks = [name for name, _, _ in items], [message(block, source) for _, source, block in items]
    both = typestore().types[ACCELERATION_BLOCKS](names, blocks)
    return bytes(typestore().serialize_cdr(both, ACCELERATION_BLOCKS, little_endian=little))


@given(st.lists(st.tuples(frame_ids, frame_ids, blocks), max_size=4), st.booleans())
def test_blocks_of_many_valves_agree_with_rosbags(items: list[tuple[str, str, Block]], little: bool) -> None:
    got = decode_blocks(many(items, little=little))
    assert [(name, one.source, one.stamp) for name, one in got] == [
        (name, source, block.stamp) for name, source, block in items
    ]
    for (_, one), (_, _, block) in zip(got, items, strict=True):
        assert_same(one, block)


@given(st.lists(st.tuples(frame_ids, frame_ids, blocks), min_size=1, max_size=3), st.data())
def test_a_cut_message_of_many_valves_is_refused(
    items: list[tuple[str, str, Block]], data: st.DataObject
) -> None:
    whole = many(items)
    with pytest.raises(CdrError):
        decode_blocks(whole[: data.draw(st.integers(0, len(whole) - 1))])


def test_a_message_without_a_block_for_each_name_is_refused() -> None:
    blocks = typestore().types[ACCELERATION_BLOCKS](["valve_1", "valve_2"], [])
    data = bytes(typestore().serialize_cdr(blocks, ACCELERATION_BLOCKS))
    with pytest.raises(CdrError, match="2 names and 0 blocks"):
        decode_blocks(data)


@given(stamps, st.floats(allow_nan=False), frame_ids)
def test_temperature_agrees_with_rosbags(stamp: int, celsius: float, frame_id: str) -> None:
    data = encode_temperature(OilTemperature(stamp, celsius), frame_id)
    other: Any = typestore().deserialize_cdr(data, TEMPERATURE)
    assert (other.temperature, other.variance, other.header.frame_id) == (celsius, 0.0, frame_id)
    assert bytes(typestore().serialize_cdr(other, TEMPERATURE, little_endian=True)) == data
    assert decode_temperature(data) == OilTemperature(stamp, celsius)


@given(blocks, st.data())
def test_a_cut_message_is_refused(block: Block, data: st.DataObject) -> None:
    whole = encode_block(block, "valve_1")
    cut = whole[: data.draw(st.integers(0, len(whole) - 1))]
    with pytest.raises(CdrError):
        decode_block(cut)


@given(st.binary(max_size=80))
def test_any_bytes_give_a_block_or_a_cdr_error(data: bytes) -> None:
    for decode in (decode_block, decode_blocks, decode_temperature, header_stamp, block_head):
        try:
            decode(data)
        except CdrError as error:
            assert str(error)  # noqa: PT017  # either outcome is right, anything else is not


def test_other_encapsulations_are_refused() -> None:
    one = np.zeros(1, np.float32)
    data = bytearray(encode_block(Block(1, 0, 1.0, one, one), "valve_1"))
    data[1] = 3
    with pytest.raises(CdrError, match="encapsulation"):
        decode_block(bytes(data))
