from __future__ import annotations

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.sliding_window import ChunkWindow, take_chunk

SCALE = np.array([3000.0, 5.0, 0.5])
TRUTH = np.array([1632.0, 4.0, 0.3])
SIZES = np.array([1e-3, 0.1, 0.7])


def taken(window: ChunkWindow, rows: Array, target: Array, given: Array, lasts: list[int]) -> Array:
    """Take a chunk; return the variances of ``given`` and of the best fit to each number of last chunks."""
    scaled, error = rows * SCALE, target - rows @ given
    verdicts = np.empty((len(lasts), 6))
    take_chunk(
        window.arrays, scaled.T @ scaled, scaled.T @ error, float(error @ error), target.size,
        given / SCALE, np.array(lasts), verdicts,
    )  # fmt: skip
    return verdicts[:, :2]


def test_variances_are_those_of_the_last_chunks_alone() -> None:
    generator = np.random.default_rng(0)
    window = ChunkWindow(SCALE, length=4)
    rows = generator.standard_normal((7, 100, 3)) * SIZES
    targets = rows @ TRUTH + 0.1 * generator.standard_normal((7, 100))
    given = 1.2 * TRUTH
    for row, aim in zip(rows, targets, strict=True):
        found = taken(window, row, aim, given, [2, 4])
    for variances, last in zip(found, (2, 4), strict=True):
        stacked, target = rows[-last:].reshape(-1, 3), targets[-last:].ravel()
        best, *_ = np.linalg.lstsq(stacked / SIZES, target, rcond=None)
        expected = [np.mean((target - stacked @ one) ** 2) for one in (given, best / SIZES)]
        assert variances == pytest.approx(expected, rel=1e-9)


def test_a_window_without_motion_is_fitted_by_nothing() -> None:
    window = ChunkWindow(SCALE, length=1)
    variances = taken(window, np.zeros((5, 3)), np.full(5, 2.0), TRUTH, [1])
    assert variances[0] == pytest.approx((4.0, 4.0))


def test_the_best_fit_is_least_squares_over_the_window() -> None:
    generator = np.random.default_rng(1)
    window = ChunkWindow(SCALE)
    rows = generator.standard_normal((100, 3)) * SIZES
    taken(window, rows, rows @ TRUTH, 0.5 * TRUTH, [1])
    assert window.best() == pytest.approx(TRUTH, rel=1e-9)


def test_adding_a_chunk_by_its_sums_is_taking_it() -> None:
    generator = np.random.default_rng(2)
    one, other = ChunkWindow(SCALE, length=5), ChunkWindow(SCALE, length=5)
    for _ in range(8):
        rows = generator.standard_normal((50, 3)) * SIZES
        target = generator.standard_normal(50)
        taken(one, rows, target, TRUTH, [2, 4])
        scaled, error = rows * SCALE, target - rows @ TRUTH
        other.add_sums(scaled.T @ scaled, scaled.T @ error, float(error @ error), 50.0, TRUTH)
    assert one.best(4).tolist() == other.best(4).tolist()


def test_chunks_of_which_no_sample_counts_leave_nothing_and_divide_nothing_by_zero() -> None:
    (variances,) = taken(ChunkWindow(SCALE), np.zeros((5, 3)), np.zeros(5), TRUTH, [1])
    assert np.all(variances > 0.0)
    assert variances == pytest.approx(0.0, abs=1e-200)
