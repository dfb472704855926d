"""Windows to judge on: half of them, in an order without a period; and which structure leaves less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from spool_core.numbers import Array
from spool_gap.evidence.held_out import Judged, by_turns
from spool_gap.likelihood.structure import structure_of
from spool_gap.result import HeldOutAgreement
from spool_sim.model import MODELS
from spool_sim.valve import find_valve

WINDOWS = st.integers(6, 700)


@given(count=WINDOWS)
def test_half_of_the_windows_are_held_out(count: int) -> None:
    assert abs(2 * int(by_turns(count).sum()) - count) <= 2


@given(count=WINDOWS)
def test_windows_held_out_have_no_period(count: int) -> None:
    held = by_turns(count)
    for period in range(1, count // 2):
        assert np.any(held[period:] != held[:-period])


def judged(windows: Array) -> Judged:
    structure = structure_of(MODELS["fluid"], find_valve("4weh10_soft"))
    return Judged(structure, HeldOutAgreement(0.0, 1.0), [], 0.0, windows)


@given(st.integers(0, 10_000))
def test_a_lead_is_the_paired_statistic_of_students_test(seed: int) -> None:
    worse, better = np.random.default_rng(seed).chisquare(8.0, (2, 20))
    lead = judged(better).lead(judged(worse))
    assert lead == pytest.approx(stats.ttest_rel(worse, better).statistic, rel=1e-9)
    assert judged(worse).lead(judged(better)) == pytest.approx(-lead, rel=1e-9)


def test_a_few_windows_or_equal_ones_give_no_lead() -> None:
    few, many = np.arange(1.0, 5.0), np.arange(1.0, 30.0)
    assert judged(few).lead(judged(2.0 * few)) == 0.0
    assert judged(many).lead(judged(many)) == 0.0
