"""Blocks read as runs are those read one by one, in the same order, whatever a bag holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_bag import blocks as ordering
from spool_bag.blocks import Item, OrderingWindows, decode_blocks, keyed_of
from spool_bag.information import Timeline
from spool_core.block import Block, BlockRun
from spool_core.cdr import CdrError, OilTemperature, decode_block, encode_block

START, PERIOD, STEP = 1_700_000_000_000_000_000, 5e-4, 20_000_000
#: What may be wrong with a message, or other than in the one before.
CHANGES = (
    "nothing", "late", "lost", "name", "period", "other length", "not a number", "cut off", "big endian",
    "unequal", "far ahead", "sequence without end", "irregular period",
)  # fmt: skip


def block(number: int, size: int = 40) -> Block:
    samples = np.random.default_rng(number).standard_normal((2, size)).astype(np.float32)
    return Block(START + number * STEP, number, PERIOD, samples[0], samples[1], "4weh10")


def message(number: int, change: str) -> bytes:
    """Return the CDR of a block that is as ``change`` says."""
    one = block(number, 41 if change == "other length" else 40)
    if change == "unequal":
        one = replace(one, body=one.body[:38], spool=np.concatenate([one.spool, one.spool[:2]]))
    elif change == "not a number":
        one = replace(one, spool=np.full_like(one.spool, np.nan))
    else:
        one = {
            "late": replace(one, stamp=one.stamp + 3),
            "lost": replace(one, sequence=one.sequence + 3),
            "name": replace(one, source="4weh11"),
            "period": replace(one, sample_period=2.0 * PERIOD),
            "far ahead": replace(one, stamp=one.stamp + 40 * 10**9),
            "sequence without end": replace(one, sequence=2**64 - 1),
            "irregular period": replace(one, sample_period=1.0 / 2048.0),
        }.get(change, one)
    data = encode_block(one, one.source)
    if change == "cut off":
        return data[:-7]
    return b"\x00\x00" + data[2:] if change == "big endian" else data


def text(item: Block | OilTemperature | None) -> str:
    """Return all of an item, bit by bit."""
    if not isinstance(item, Block):
        return repr(item)
    samples = item.body.tobytes(), item.spool.tobytes(), item.body.dtype, item.spool.dtype
    return repr((item.stamp, item.sequence, item.sample_period, item.source, *samples))


def one_by_one(item: Item) -> list[Block | OilTemperature]:
    return list(item.blocks()) if isinstance(item, BlockRun) else [item]


def decoded(data: bytes) -> Block | None:
    try:
        return decode_block(data)
    except CdrError:
        return None


@given(changes=st.lists(st.tuples(st.integers(0, 59), st.sampled_from(CHANGES)), max_size=8))
@settings(max_examples=60, deadline=None)
def test_messages_are_decoded_together_as_one_by_one(changes: list[tuple[int, str]]) -> None:
    as_is = dict(changes)
    messages = [message(number, as_is.get(number, "nothing")) for number in range(60)]
    for size in {len(data) for data in messages}:
        alike = [data for data in messages if len(data) == size]
        found: list[str] = []
        for item, count in decode_blocks(alike):
            blocks = [None] if item is None else one_by_one(item)
            assert len(blocks) == count
            found += map(text, blocks)
        assert found == [text(decoded(data)) for data in alike]


def test_a_sound_recording_comes_in_few_runs() -> None:
    found = list(decode_blocks([message(number, "nothing") for number in range(100)]))
    assert [count for _, count in found] == [100]


STRETCH = st.tuples(
    st.integers(1, 300),
    st.sampled_from([0, 0, 0, 7, 10_000_000, -60_000_000, -4_000_000_000, -7_000_000_000, 12_000_000_000]),
    st.booleans(),
)


@pytest.mark.parametrize(("messages", "size"), [(20_000, 80_000_000), (37, 80_000_000), (20_000, 90_000)])
@given(stretches=st.lists(STRETCH, min_size=1, max_size=8), valves=st.integers(1, 2))
@settings(max_examples=40, deadline=None)
def test_runs_are_put_in_order_as_their_blocks(
    messages: int, size: int, stretches: list[tuple[int, int, bool]], valves: int
) -> None:
    """However late something comes, and however little may be held."""
    apart, together = OrderingWindows(), OrderingWindows()
    expected: list[str] = []
    found: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ordering, "LONGEST_QUEUE", messages)
        patch.setattr(ordering, "LARGEST_QUEUE", size)
        patch.setattr(ordering, "LARGEST_QUEUES", size + size // 2)
        stamp, sequence, arrival = START, 0, 0
        for place, (count, late, warm) in enumerate(stretches):
            stamp += late
            samples = np.full(2 * count, place, np.float32)
            run = BlockRun(stamp, sequence, 0.01, samples, samples, "", 2)
            items: list[Item] = [OilTemperature(stamp + 50_000_000, float(place)), run] if warm else [run]
            for item in items:
                valve, many = str(place % valves), one_by_one(item)
                arrival += 1
                for name, due in together.take(valve, keyed_of(item, arrival, 400, len(many))):
                    found += [name + text(one) for one in one_by_one(due)]
                for number, one in enumerate(many):
                    single = keyed_of(one, 1000 * arrival + number, 400, 1)
                    expected += [name + text(due) for name, due in apart.take(valve, single)]
            stamp, sequence = run.last.end, sequence + count
        found += [name + text(one) for name, due in together.rest() for one in one_by_one(due)]
        expected += [name + text(due) for name, due in apart.rest()]
    assert found == expected


@given(
    stretches=st.lists(
        st.tuples(st.integers(1, 80), st.sampled_from([0, 0, 900_000_000, -3_000_000_000, 5_000_000_000])),
        min_size=1,
        max_size=6,
    )
)
def test_a_timeline_is_told_runs_as_their_blocks(stretches: list[tuple[int, int]]) -> None:
    together, apart = Timeline(), Timeline()
    stamp, sequence = START, 0
    for count, late in stretches:
        stamp += late
        samples = np.zeros(2 * count, np.float32)
        run = BlockRun(stamp, sequence, 0.01, samples, samples, "", 2)
        together.take_run(run)
        for one in run.blocks():
            apart.take(one)
        stamp, sequence = run.last.end, sequence + count
        assert together == apart
