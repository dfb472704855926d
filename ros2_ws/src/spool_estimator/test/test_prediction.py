"""What the run in parallel with the machine says of its samples, against the same in Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_estimator.prediction import (
    BODY,
    COUNT,
    DISPLACEMENT,
    KINDS,
    NOISE,
    RESIDUAL,
    SHARPENINGS,
    SUMS,
    TARGET,
    VELOCITY,
    Prediction,
    Samples,
    score_noise,
)

SCALE = np.array([1632.0, 5.0, 0.5])


def test_a_slow_motion_is_what_it_was_before_the_filter_of_each_kind() -> None:
    frequency = np.array([0.01, 0.02, 0.03])  # of the sample rate
    for kind, weights in list(zip(KINDS, SHARPENINGS, strict=True))[1:]:
        for place, taken in ((2.0, weights[:5]), (2.5, weights[5:11]), (1.0, weights[11:])):
            waves = np.exp(2j * np.pi * np.outer(frequency, np.arange(taken.size) - place))
            assert np.abs(kind.response(frequency) * (waves @ taken) - 1.0).max() < 1e-3


@given(
    k=st.floats(100.0, 5000.0), c=st.floats(-1.0, 20.0), f=st.floats(-0.2, 2.0), seed=st.integers(0, 999),
    pointwise=st.booleans(),
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_the_noise_score_is_half_the_slope_of_the_answer_to_white_noise(
    k: float, c: float, f: float, seed: int, pointwise: bool
) -> None:
    mass, period = 0.18, 5e-4
    sums = np.random.default_rng(seed).uniform(0.1, 10.0, SUMS)
    sums[RESIDUAL] *= mass**2  # of the size of the body's noise: either may be the smaller one
    score = np.empty(3)
    score_noise(sums, np.array([k, c, f]), SCALE, mass, period, pointwise, score)
    by_friction = math.sqrt(2.0) / (math.pi * math.sqrt(sums[VELOCITY] / sums[COUNT]))
    seen = min(sums[NOISE], sums[RESIDUAL] / mass**2 * (1.0 if pointwise else 8.0 / 3.0))

    def answer(stiffness: float, damping: float) -> float:
        return mass**2 * seen * period * (damping**2 + stiffness * mass) / (2.0 * damping * mass)

    damping = max(c + by_friction * abs(f), 1e-3 * SCALE[1])
    by_stiffness = (answer(1.001 * k, damping) - answer(0.999 * k, damping)) / (0.002 * k)
    by_damping = (answer(k, 1.0001 * damping) - answer(k, 0.9999 * damping)) / (0.0002 * damping)
    expected = -0.5 * np.array([by_stiffness, by_damping, by_damping * by_friction]) * SCALE
    np.testing.assert_allclose(score, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def test_a_standstill_has_no_noise_score() -> None:
    score = np.ones(3)
    score_noise(np.zeros(SUMS), SCALE, SCALE, 0.18, 5e-4, False, score)
    assert not score.any()


def test_a_point_value_close_to_a_jump_teaches_nothing_whatever_it_reads() -> None:
    """It may lie on the other side of the jump."""
    parameters, time = np.array([1632.0, 4.0, 0.3]), 5e-4 * np.arange(1500)
    body = (8.0 * np.sin(195.0 * time) + 5.0 * np.sin(423.0 * time)).astype(np.float32)

    def product_of(spool: Samples) -> list[float]:
        prediction = Prediction(5e-4, 0.18, SCALE)
        prediction.take(body, spool, parameters, pointwise=True)
        return prediction.product.tolist()

    spool = np.zeros_like(body)
    expected, model, velocity = product_of(spool), Prediction(5e-4, 0.18, SCALE), []
    for n in range(body.size):
        model.take(body[n : n + 1], spool[n : n + 1], parameters)
        velocity.append(model.state[1])
    before, after = np.array(velocity[2:-1]), np.array(velocity[3:])  # its motion is two samples behind
    close = []
    for place in np.flatnonzero(before * after < 0.0).tolist():
        share = before[place] / (before[place] - after[place])
        for sample, away in ((place, share), (place + 1, 1.0 - share)):
            wrong = spool.copy()
            wrong[sample] += 1.0
            if away < 0.12:
                assert product_of(wrong) == expected
                close.append(sample - place)
            elif away > 0.4:
                assert product_of(wrong) != expected
    assert min(close.count(0), close.count(1)) >= 3


def test_mean_squares_are_the_sums_over_their_count_and_clearing_begins_anew() -> None:
    prediction = Prediction(5e-4, 0.18, SCALE)
    body, spool = np.random.default_rng(0).standard_normal((2, 400)).astype(np.float32)
    prediction.take(body, spool, SCALE)
    wanted = [RESIDUAL, TARGET, BODY, DISPLACEMENT, VELOCITY]
    assert prediction.mean_squares == pytest.approx(prediction.sums[wanted] / prediction.sums[COUNT])
    assert prediction.gram == pytest.approx(prediction.gram.T)
    prediction.clear()
    assert not prediction.sums.any()
    assert not prediction.gram.any()
