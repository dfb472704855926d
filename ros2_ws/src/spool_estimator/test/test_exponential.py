from __future__ import annotations

from itertools import pairwise

import numpy as np
import padasip
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spool_estimator.recursive import ExponentialForgetting

SIZES = np.array([3.0, -1.0, 0.5, 2.0, 0.0, -0.2])


def data(samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    rows = generator.standard_normal((samples, SIZES.size))
    return rows, rows @ SIZES + 0.1 * generator.standard_normal(samples)


def reference(
    rows: np.ndarray, target: np.ndarray, factor: float, initial: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return parameters and covariance, written down as in the textbook."""
    theta, p = np.zeros(rows.shape[1]), np.eye(rows.shape[1]) * initial
    for x, y in zip(rows, target, strict=True):
        gain = p @ x / (factor + x @ p @ x)
        theta = theta + gain * (y - x @ theta)
        p = (p - np.outer(gain, x @ p)) / factor
    return theta, p


@pytest.mark.parametrize("factor", [0.98, 0.9995, 1.0])
def test_it_equals_padasip_and_the_textbook(factor: float) -> None:
    rows, target = data(3000)
    ours = ExponentialForgetting(6, factor, initial=10.0)
    ours.update(rows, target)
    peer = padasip.filters.FilterRLS(n=6, mu=factor, eps=0.1, w="zeros")
    peer.run(target, rows)
    np.testing.assert_allclose(ours.parameters, peer.w, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(ours.covariance, peer.R, rtol=1e-6, atol=1e-9)
    theta, p = reference(rows, target, factor, 10.0)
    np.testing.assert_allclose(ours.parameters, theta, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ours.covariance, p, rtol=1e-6, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(edges=st.lists(st.integers(0, 500), max_size=12))
def test_how_the_samples_are_split_changes_no_bit(edges: list[int]) -> None:
    rows, target = data(500)
    whole, split = ExponentialForgetting(6, 0.999), ExponentialForgetting(6, 0.999)
    whole.update(rows, target)
    places = [0, *sorted(edges), 500]
    for low, high in pairwise(places):
        split.update(rows[low:high], target[low:high])
    np.testing.assert_array_equal(whole.parameters, split.parameters)
    np.testing.assert_array_equal(whole.covariance, split.covariance)
    np.testing.assert_array_equal(whole.errors, split.errors)


def test_a_change_is_followed_within_the_memory() -> None:
    rows, _ = data(4000)
    target = rows @ SIZES
    target[2000:] = rows[2000:] @ (2.0 * SIZES)
    fit = ExponentialForgetting(6, 1.0 - 1.0 / 200.0)
    fit.update(rows[:2600], target[:2600])  # three memories after the change
    np.testing.assert_allclose(fit.parameters, 2.0 * SIZES, rtol=0.0, atol=0.2)
    fit.update(rows[2600:], target[2600:])
    np.testing.assert_allclose(fit.parameters, 2.0 * SIZES, rtol=0.0, atol=1e-2)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_standard_deviations_hold_for_white_and_for_coloured_errors(colour: float) -> None:
    generator = np.random.default_rng(4)
    inside = 0
    for _ in range(200):
        slow = np.sin(np.outer(np.arange(2000), [0.05, 0.083]) + generator.uniform(0.0, 6.0, 2))
        white = generator.standard_normal(2000)
        noise = np.zeros(2000)
        for n in range(1, 2000):
            noise[n] = colour * noise[n - 1] + white[n]
        fit = ExponentialForgetting(2, 1.0)
        fit.update(slow, slow @ [1.0, -2.0] + noise)
        inside += int((np.abs(fit.parameters - [1.0, -2.0]) < 2.0 * fit.standard_deviations).sum())
    assert 0.9 < inside / 400 <= 1.0


def test_hours_without_excitation_do_not_wind_it_up() -> None:
    fit = ExponentialForgetting(6, 0.999, initial=1e4, largest=6e4)
    rows, target = data(2000)
    fit.update(rows, target)
    fit.update(np.zeros((200_000, 6)), np.zeros(200_000))
    assert np.trace(fit.covariance) < 6.1e4
    np.testing.assert_allclose(fit.parameters, SIZES, atol=0.1)
    assert np.isfinite(fit.covariance).all()
