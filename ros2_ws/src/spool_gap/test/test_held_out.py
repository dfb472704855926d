"""Windows to judge on: half of them, in an order without a period."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from spool_gap.evidence.held_out import by_turns

WINDOWS = st.integers(6, 700)


@given(count=WINDOWS)
def test_half_of_the_windows_are_held_out(count: int) -> None:
    assert abs(2 * int(by_turns(count).sum()) - count) <= 2


@given(count=WINDOWS)
def test_windows_held_out_have_no_period(count: int) -> None:
    held = by_turns(count)
    for period in range(1, count // 2):
        assert np.any(held[period:] != held[:-period])
