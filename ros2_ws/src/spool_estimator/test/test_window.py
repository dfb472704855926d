from __future__ import annotations

import numpy as np
import pytest
from spool_estimator.sliding_window import ChunkWindow

SCALE = np.array([3000.0, 5.0, 0.5])
TRUTH = np.array([1632.0, 4.0, 0.3])
SIZES = np.array([1e-3, 0.1, 0.7])


def test_variances_are_those_of_the_last_chunks_alone() -> None:
    generator = np.random.default_rng(0)
    window = ChunkWindow(SCALE, length=4)
    rows = generator.standard_normal((7, 100, 3)) * SIZES
    targets = rows @ TRUTH + 0.1 * generator.standard_normal((7, 100))
    for number in range(7):
        assert window.full == (number >= 4)
        window.add(rows[number], targets[number])
    stacked, target = rows[3:].reshape(-1, 3), targets[3:].ravel()
    given = 1.2 * TRUTH
    best, *_ = np.linalg.lstsq(stacked / SIZES, target, rcond=None)
    expected = [np.mean((target - stacked @ one) ** 2) for one in (given, best / SIZES)]
    assert window.variances(given) == pytest.approx(expected, rel=1e-9)


def test_cleared_it_is_empty() -> None:
    window = ChunkWindow(SCALE, length=1)
    window.add(np.ones((5, 3)), np.ones(5))
    assert window.full
    window.clear()
    assert not window.full


def test_a_window_without_motion_is_fitted_by_nothing() -> None:
    window = ChunkWindow(SCALE, length=1)
    window.add(np.zeros((5, 3)), np.full(5, 2.0))
    assert window.variances(TRUTH) == pytest.approx((4.0, 4.0))


def test_the_best_fit_is_least_squares_over_the_window() -> None:
    generator = np.random.default_rng(1)
    window = ChunkWindow(SCALE)
    rows = generator.standard_normal((100, 3)) * SIZES
    window.add(rows, rows @ TRUTH)
    assert window.best() == pytest.approx(TRUTH, rel=1e-9)


def test_taking_a_chunk_is_adding_it_and_judging_each_length() -> None:
    generator = np.random.default_rng(2)
    one, other = ChunkWindow(SCALE, length=5), ChunkWindow(SCALE, length=5)
    for _ in range(8):
        rows = generator.standard_normal((50, 3))
        error = generator.standard_normal(50)
        sums = rows.T @ rows, rows.T @ error, float(error @ error), 50.0, TRUTH
        verdicts = one.take(*sums, np.array([2, 4]))
        other.add_sums(*sums)
        assert verdicts == [list(other.judge(TRUTH, 2)), list(other.judge(TRUTH, 4))]
