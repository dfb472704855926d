"""A run of blocks is what its blocks are, and every check that takes it says what they would make it say."""

from __future__ import annotations

import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_core.block import Block, BlockRun, joined
from spool_core.block_gate import BlockGate, Verdict

START = 1_700_000_000_000_000_000
PERIOD = 5e-4


def run(count: int, size: int, sequence: int = 0, stamp: int = START) -> BlockRun:
    samples = np.arange(count * size, dtype=np.float32)
    return BlockRun(stamp, sequence, PERIOD, samples, -samples, "valve", size)


def same(one: Block, other: Block) -> bool:
    alike = replace(one, body=other.body, spool=other.spool) == other
    return alike and np.array_equal(one.body, other.body) and np.array_equal(one.spool, other.spool)


@given(count=st.integers(1, 30), size=st.integers(1, 50), cut=st.integers(0, 30))
def test_its_blocks_follow_each_other_and_its_parts_are_their_runs(count: int, size: int, cut: int) -> None:
    whole = run(count, size)
    blocks = list(whole.blocks())
    assert len(blocks) == len(whole) == count
    assert all(later.stamp == earlier.end for earlier, later in pairwise(blocks))
    assert same(joined([whole]), joined(blocks))
    assert same(whole.last, blocks[-1])
    if 0 < cut < count:
        parts = [whole.part(0, cut), whole.part(cut, count)]
        found = [block for part in parts for block in part.blocks()]
        assert all(map(same, found, blocks))
        assert same(joined(parts), joined(blocks))


@given(
    counts=st.lists(st.integers(1, 120), min_size=1, max_size=8),
    size=st.sampled_from([1, 7, 40, 300]),
    shift=st.lists(st.sampled_from([0, 0, 0, 1, 700_000, -900_000_000]), min_size=8, max_size=8),
)
@settings(max_examples=50, deadline=None)
def test_the_sample_rate_is_judged_as_block_by_block(counts: list[int], size: int, shift: list[int]) -> None:
    together, apart = BlockGate(), BlockGate()
    stamp, sequence = START, 0
    for count, late in zip(counts, shift, strict=False):
        stamp += late
        part = run(count, size, sequence, stamp)
        list(together.admitted([part], lambda: 10**6))
        for block in part.blocks():
            apart.judge(block)
        assert together.rate == apart.rate
        stamp, sequence = part.last.end, sequence + count


@given(counts=st.lists(st.integers(1, 40), min_size=1, max_size=5))
@settings(max_examples=20, deadline=None)
def test_a_gate_that_admits_runs_stands_where_it_would_stand_behind_their_blocks(counts: list[int]) -> None:
    gate = BlockGate()
    for block in run(200, 40).blocks():
        gate.judge(block)
    alone = copy.deepcopy(gate)
    runs, sequence = [], 200
    for count in counts:
        runs.append(run(count, 40, sequence, START + sequence * 20_000_000))
        sequence += count
    ((whole, _),) = gate.admitted(runs, lambda: 10**6)
    for block in (block for one in runs for block in one.blocks()):
        alone.judge(block)
    assert whole.body.size == 40 * sum(counts)
    assert (gate.last, gate.accepted, gate.rate) == (alone.last, alone.accepted, alone.rate)


def test_of_a_run_with_a_broken_sample_a_gate_refuses_its_block_alone() -> None:
    gate = BlockGate()
    for block in run(200, 40).blocks():
        gate.judge(block)
    broken = run(10, 40, 200, START + 200 * 20_000_000)
    broken.body[77] = np.nan
    found = list(gate.admitted([broken], lambda: 10**6))
    refused = [block.sequence for block, verdict in found if verdict is Verdict.REFUSED]
    assert (refused, sum(block.blocks for block, _ in found)) == ([201], 10)
