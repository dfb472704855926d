from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spool_monitor.parameter_drift import CumulativeSum, threshold_for

SECOND = 1_000_000_000


@given(run=st.floats(1e3, 1e8), allowance=st.floats(0.1, 1.0), variance=st.floats(1e-3, 10.0))
def test_the_threshold_has_the_run_length_asked_for(run: float, allowance: float, variance: float) -> None:
    """Mean time to a false alarm of a one-sided sum of white noise, in closed form."""
    exponent = 2.0 * allowance * threshold_for(run, allowance, variance) / variance
    assert variance / (2.0 * allowance**2) * (math.expm1(exponent) - exponent) == pytest.approx(run, rel=1e-3)


def test_without_spread_nothing_is_false() -> None:
    assert threshold_for(1e6, 0.5, 0.0) == 0.0


def test_correlated_noise_alarms_falsely_no_more_often_than_stated() -> None:
    """A first-order process of 4 s memory, values each second: 100 runs against the stated 300 s."""
    generator = np.random.default_rng(5)
    memory, deviation, allowance = 4.0, 0.5, 0.3
    correlation = math.exp(-1.0 / memory)
    threshold = threshold_for(300.0, allowance, 2.0 * memory * deviation**2)
    lengths = []
    for _ in range(100):
        value, above = deviation * generator.standard_normal(), 0.0
        second = 0
        while above < threshold:
            second += 1
            fresh = deviation * math.sqrt(1.0 - correlation**2) * generator.standard_normal()
            value = correlation * value + fresh
            above = max(0.0, above + value - allowance)
        lengths.append(second)
    # The Brownian approximation is on the safe side where the memory is as long as the sum's own time.
    assert np.mean(lengths) > 300.0


@given(st.lists(st.floats(-5.0, 5.0), max_size=200))
def test_it_is_the_textbooks_sum(changes: list[float]) -> None:
    made = CumulativeSum(0.5, 2.0)
    up = down = 0.0
    for second, change in enumerate(changes):
        made.update(second * SECOND, change, 1.0)
        bounded = min(2.0, max(-2.0, change))
        up, down = max(0.0, up + bounded - 0.5), max(0.0, down - bounded - 0.5)
    assert (made.up, made.down) == pytest.approx((up, down), abs=1e-9)
    assert made.size == max(made.up, made.down)


def test_it_knows_side_and_onset() -> None:
    made = CumulativeSum(0.5, 2.0)
    for second in range(1, 51):
        made.update(second * SECOND, 0.0 if second <= 30 else -1.0, 1.0)
    assert made.side == -1
    assert made.since == 30 * SECOND
    made.reset()
    assert (made.side, made.since, made.size) == (0, 0, 0.0)
