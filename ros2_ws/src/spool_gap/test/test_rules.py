"""When a richer law is taken for a simpler one that it contains, and when an effect means nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_estimator.identification.record import Record
from spool_gap.registry import EFFECTS
from spool_gap.selection.evidence import in_windows
from spool_gap.selection.windows import trimmed_sum
from spool_gap.simulation.segments import Stretch, span_of
from spool_gap.stages.sliding_laws import too_far
from spool_gap.thresholds import THRESHOLDS

FEWEST, BY_CHANCE = int(THRESHOLDS.fewest_windows), THRESHOLDS.by_chance
WINDOWS = st.integers(FEWEST, 60)
SIZES = st.floats(1e-3, 1e3)


@given(count=WINDOWS, size=SIZES, seed=st.integers(0, 2**32 - 1))
def test_a_law_that_gains_in_every_window_wins_however_little(count: int, size: float, seed: int) -> None:
    gains = size * np.random.default_rng(seed).uniform(0.1, 1.0, count)
    assert in_windows(gains, share=1e-9)


@given(count=WINDOWS, size=st.floats(1.0, 1e6), seed=st.integers(0, 2**32 - 1))
def test_no_gain_in_two_windows_makes_up_for_losses_in_all_others(count: int, size: float, seed: int) -> None:
    gains = -np.random.default_rng(seed).uniform(0.1, 1.0, count)
    gains[:2] = size * 1e3
    assert not in_windows(gains, share=1e3)


@pytest.mark.parametrize("count", [FEWEST, 12, 24])
def test_gains_of_either_sign_win_as_rarely_as_said(count: int) -> None:
    """Heavy tails, as simulations of friction err."""
    drawn = np.random.default_rng(5).standard_t(2.0, (3000, count))
    won = sum(in_windows(gains, share=1.0) for gains in drawn)
    # Four deviations of a binomial count.
    assert won <= 3000 * BY_CHANCE + 4.0 * np.sqrt(3000 * BY_CHANCE)


@given(count=st.integers(1, FEWEST - 1), share=st.floats(0.0, 1.0))
def test_few_windows_decide_by_the_share_of_all(count: int, share: float) -> None:
    assert in_windows(np.ones(count), share) == (share > THRESHOLDS.clearly)


@given(count=st.integers(10, 60), outlier=st.floats(-1e9, 1e9), seed=st.integers(0, 2**32 - 1))
def test_no_single_window_decides_between_laws(count: int, outlier: float, seed: int) -> None:
    """With play a run goes another way in one window, and leaves any amount there."""
    gains = np.random.default_rng(seed).uniform(0.5, 1.5, count)
    gains[0] = outlier
    assert 0.5 * count < trimmed_sum(gains) < 1.5 * count


@given(count=WINDOWS, behind=st.floats(1.0, 2.0), seed=st.integers(0, 2**32 - 1))
def test_a_law_is_given_up_that_is_behind_in_every_window(count: int, behind: float, seed: int) -> None:
    costs = np.random.default_rng(seed).uniform(0.5, 1.5, count)
    if abs(behind - THRESHOLDS.too_far_everywhere) > 1e-6:
        assert too_far(costs, behind * costs) == (behind > THRESHOLDS.too_far_everywhere)


@given(count=st.integers(1, FEWEST - 1), behind=st.floats(1.0, 2.0))
def test_few_windows_give_up_a_law_only_that_is_a_third_behind(count: int, behind: float) -> None:
    if abs(behind - THRESHOLDS.too_far) > 1e-6:
        assert too_far(np.ones(count), np.full(count, behind)) == (behind > THRESHOLDS.too_far)


@given(seconds=st.floats(10.0, 4000.0), sign=st.sampled_from([-1.0, 1.0]))
def test_a_drift_is_a_trifle_by_what_it_does_over_the_record(seconds: float, sign: float) -> None:
    """A tenth of a kelvin of the oil changes the damping by half a percent."""
    drift = EFFECTS["damping_drift"]
    assert drift.trifling({"damping_drift_rate": sign * 0.004 / seconds}, seconds)
    assert not drift.trifling({"damping_drift_rate": sign * 0.006 / seconds}, seconds)


@pytest.mark.parametrize("apart", [0.0, 3588.0])
def test_a_record_in_parts_is_as_long_as_from_the_first_to_the_last(apart: float) -> None:
    """Of a long bag parts of 12 s are held: the oil drifts between them, too."""
    period = 0.0005
    still = np.zeros(24_000)
    begins = [round(begin * 1e9) for begin in (5.0, 5.0 + apart)]
    parts = [Record("part", begin, period, still, still, origin=0) for begin in begins]
    stretches = [cast("Stretch", SimpleNamespace(record=record)) for record in parts]
    assert span_of(stretches) == pytest.approx(12.0 + apart)


def test_friction_is_never_a_trifle() -> None:
    assert not EFFECTS["coulomb_friction"].trifling({"coulomb_force": 1e-9}, 40.0)
