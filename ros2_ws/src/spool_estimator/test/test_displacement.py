"""Displacement of the spool in the body, as a filter that joins a running machine finds it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_estimator.history import Displacement, follow_displacement

LOW_CUT = 4.0


def settled_rms(frequency: float, period: float) -> float:
    """Return the filter's settled rms output, m, for an acceleration of 1 m/s^2 peak."""
    turn = np.exp(2j * math.pi * frequency * period)
    kept = math.exp(-2.0 * math.pi * LOW_CUT / 1.554 * period)
    leak = math.exp(-0.25 * math.pi * LOW_CUT * period)
    passed = ((turn - 1.0) / (turn - kept)) ** 2
    return float(abs(passed * (period * turn / (turn - leak)) ** 2) / math.sqrt(2.0))


@pytest.mark.slow
@given(
    frequency=st.floats(LOW_CUT, 60.0),
    phase=st.floats(0.0, 2.0 * math.pi),
    offset=st.floats(-30.0, 30.0),
    rate=st.sampled_from([500.0, 833.0, 2000.0, 5000.0]),
)
@settings(max_examples=60, deadline=None)
def test_a_vibration_that_was_there_before_is_known_after_a_second(
    frequency: float, phase: float, offset: float, rate: float
) -> None:
    chunk = round(0.1 * rate)
    time = np.arange(30 * chunk) / rate
    spool = offset + 10.0 * np.sin(2.0 * math.pi * frequency * time + phase)
    samples = np.stack((np.zeros_like(spool), spool)).astype(np.float32)
    displacement = Displacement(1.0 / rate, LOW_CUT, chunk, share=0.1)
    found = []
    for begin in range(0, time.size, chunk):
        follow_displacement(samples[:, begin : begin + chunk], displacement.arrays)
        found.append(displacement.mean_square)
    expected = 10.0 * settled_rms(frequency, 1.0 / rate)
    unknown = math.ceil(rate / chunk - 1e-9) - 1
    assert all(math.isnan(one) for one in found[:unknown])
    assert math.sqrt(found[unknown]) == pytest.approx(expected, rel=0.04)
    # A chunk of 0.1 s holds less than half a period of the slowest vibration.
    assert np.sqrt(found[unknown:]) == pytest.approx(np.full(30 - unknown, expected), rel=0.06)


def test_a_spool_at_rest_does_not_move_whatever_the_offsets() -> None:
    samples = np.full((2, 200), 9.81, np.float32)
    samples[1] = -3.0
    displacement = Displacement(5e-4, LOW_CUT, 200, share=0.1)
    for _ in range(20):
        follow_displacement(samples, displacement.arrays)
    assert displacement.mean_square == pytest.approx(0.0, abs=1e-20)


def test_after_a_reset_nothing_is_known_for_a_second() -> None:
    rng = np.random.default_rng(3)
    displacement = Displacement(5e-4, LOW_CUT, 200, share=0.1)
    blocks = rng.standard_normal((25, 2, 200)).astype(np.float32)
    for block in blocks:
        follow_displacement(block, displacement.arrays)
    displacement.reset()
    again, fresh = [], Displacement(5e-4, LOW_CUT, 200, share=0.1)
    for block in blocks[:12]:
        follow_displacement(block, displacement.arrays)
        follow_displacement(block, fresh.arrays)
        again.append((displacement.mean_square, fresh.mean_square))
    assert [math.isnan(one) for one, _ in again] == [True] * 9 + [False] * 3
    assert again[9:] == [(one, one) for _, one in again[9:]]
