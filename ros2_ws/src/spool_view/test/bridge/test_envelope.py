"""Envelope of a waveform: no peak is lost, and nothing is made up over a gap."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from spool_core.block import Block
from spool_view.plots_node import Envelope


@given(st.lists(st.integers(1, 57), min_size=1, max_size=12), st.integers(1, 40))
def test_however_samples_are_cut_into_blocks_bounds_are_those_of_the_intervals(
    sizes: list[int], width: int
) -> None:
    draw = np.random.default_rng(sum(sizes))
    rows = draw.standard_normal((2, sum(sizes))).astype(np.float32)
    envelope = Envelope(1000.0 / width)
    found, begin = [], 0
    for number, size in enumerate(sizes):
        part = rows[:, begin : begin + size]
        stamp = 10**18 + begin * 10**6
        found += envelope.update(Block(stamp, number, 1e-3, part[0], part[1], "v"))
        begin += size
    assert len(found) == sum(sizes) // width
    for number, point in enumerate(found):
        part = rows[:, number * width : (number + 1) * width]
        assert point.body == (part[0].min(), part[0].max())
        assert point.spool == (part[1].min(), part[1].max())
        assert point.stamp == 10**18 + number * width * 10**6


def test_an_interval_that_a_lost_block_cuts_is_left_out() -> None:
    envelope = Envelope(100.0)
    row = np.ones(15, dtype=np.float32)
    first = envelope.update(Block(10**18, 0, 1e-3, row, row, "v"))
    after = envelope.update(Block(10**18 + 10**9, 5, 1e-3, row, row, "v"))
    assert [point.stamp for point in first] == [10**18]
    assert [point.stamp for point in after] == [10**18 + 10**9]
