from __future__ import annotations

import numpy as np
import pytest
from spool_core.numbers import Array
from spool_estimator.recursive import RecursiveLeastSquares, advance, times

SCALE = np.array([3000.0, 5.0, 0.5])
TRUTH = np.array([1632.0, 4.0, 0.3])
#: Typical displacement (m), velocity (m/s) and direction (1) of a row.
SIZES = np.array([1e-3, 0.1, 0.7])
#: Chunks that a recursion begins with.
BATCH = 10


def regression(pairs: list[tuple[Array, Array]], forgetting: float) -> RecursiveLeastSquares:
    """Return a recursion that began with the fit to the first of the chunks, and has seen all of them."""
    scaled = [(rows * SCALE, target) for rows, target in pairs[:BATCH]]
    grams = np.array([rows.T @ rows for rows, _ in scaled])
    products = np.array([rows.T @ target for rows, target in scaled])
    found = np.linalg.solve(grams.sum(axis=0) + np.eye(3) * 0.05**2, products.sum(axis=0))
    fit = RecursiveLeastSquares(SCALE, forgetting, noise=0.05)
    fit.begin(found * SCALE, grams, products - grams @ found, np.zeros(3))
    for rows, target in pairs[BATCH:]:
        take(fit, rows, target)
    return fit


def take(fit: RecursiveLeastSquares, rows: Array, target: Array) -> None:
    scaled, change = rows * fit.scale, np.zeros(fit.scale.size)
    score = scaled.T @ (target - rows @ fit.parameters)
    advance(
        fit.arrays, scaled.T @ scaled, score, np.zeros(score.size), 1.0,
        fit.forgetting, fit.noise, change,
    )  # fmt: skip
    fit.parameters += change * fit.scale


def chunks(count: int, length: int = 100, seed: int = 0) -> list[tuple[Array, Array]]:
    generator = np.random.default_rng(seed)
    pairs = []
    for _ in range(count):
        rows = generator.standard_normal((length, 3)) * SIZES
        pairs.append((rows, rows @ TRUTH + 0.1 * generator.standard_normal(length)))
    return pairs


def weighted_least_squares(pairs: list[tuple[Array, Array]], weights: Array, prior: float) -> Array:
    """Return the solution of all chunks, in units of the scale where the prior is the unit matrix."""
    gram = np.eye(3) * 0.05**2 * prior
    score = np.zeros(3)
    for (rows, target), weight in zip(pairs, weights, strict=True):
        gram += weight * (rows * SCALE).T @ (rows * SCALE)
        score += weight * (rows * SCALE).T @ target
    return np.asarray(np.linalg.solve(gram, score) * SCALE)


def test_without_forgetting_it_is_least_squares_over_all() -> None:
    pairs = chunks(80)
    fit = regression(pairs, 0.0)
    np.testing.assert_allclose(
        fit.parameters, weighted_least_squares(pairs, np.ones(80), prior=1.0), rtol=1e-9
    )


@pytest.mark.parametrize("forgetting", [0.01, 0.1, 0.5])
def test_with_every_direction_excited_it_forgets_exponentially(forgetting: float) -> None:
    rows, _ = chunks(1)[0]
    generator = np.random.default_rng(1)
    pairs = [(rows, rows @ (TRUTH * generator.uniform(0.5, 2.0, 3))) for _ in range(60)]
    fit = regression(pairs, forgetting)
    ages = np.minimum(np.arange(59, -1, -1.0), 60 - BATCH)  # the first ones are a batch, all as old
    weights = (1.0 - forgetting) ** ages
    weights[:BATCH] *= min(1.0, 1.0 / (BATCH * forgetting))
    expected = weighted_least_squares(pairs, weights, prior=weights[0])
    np.testing.assert_allclose(fit.parameters, expected, rtol=1e-5)  # the prior is held a little longer


def test_follows_a_change_of_all_parameters_within_the_memory() -> None:
    fit = regression([(rows, rows @ TRUTH) for rows, _ in chunks(50)], 0.1)
    for rows, _ in chunks(10, seed=2):
        take(fit, rows, rows @ (2.0 * TRUTH))
    # Ten chunks at a share of 0.1 each: at most 1 - 0.9^10 of the step, less where a chunk brings less.
    done = fit.parameters / TRUTH - 1.0
    assert ((done > 0.4) & (done < 1.0 - 0.9**10 + 0.02)).all(), done


def test_a_direction_that_is_not_excited_is_held_with_its_certainty() -> None:
    # Orthogonal columns: nothing of the third parameter can be told from the other two.
    rows = np.kron(np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1.0]]), np.ones((25, 1))) * SIZES
    generator = np.random.default_rng(7)
    pairs = [(rows, rows @ TRUTH + 0.1 * generator.standard_normal(100)) for _ in range(100)]
    fit = regression(pairs, 0.025)
    held, certainty = fit.parameters[2], fit.standard_deviations[2]
    still = rows * np.array([1.0, 1.0, 0.0])
    for _ in range(1000):
        take(fit, still, still @ (1.5 * TRUTH) + 0.1 * generator.standard_normal(100))
    assert fit.parameters[2] == pytest.approx(held, rel=1e-6)
    assert fit.standard_deviations[2] == pytest.approx(certainty, rel=1e-6)
    np.testing.assert_allclose(fit.parameters[:2], 1.5 * TRUTH[:2], rtol=0.01)


def test_standstill_changes_nothing_for_1000_chunks() -> None:
    fit = regression(chunks(100), 0.025)
    before = (fit.parameters.copy(), fit.information.copy(), fit.covariance.copy())
    for _ in range(1000):
        take(fit, np.zeros((100, 3)), np.zeros(100))
    for old, new in zip(before, (fit.parameters, fit.information, fit.covariance), strict=True):
        np.testing.assert_allclose(new, old, rtol=1e-9, atol=1e-12 * np.abs(old).max())


def noise(kind: str, shape: tuple[int, int], generator: np.random.Generator) -> Array:
    """Return white noise, or first-order coloured noise with correlation 0.9 from sample to sample."""
    white = generator.standard_normal(shape)
    if kind == "white":
        return white
    coloured = np.empty(shape)
    coloured[:, 0] = white[:, 0]
    for n in range(1, shape[1]):
        coloured[:, n] = 0.9 * coloured[:, n - 1] + np.sqrt(1.0 - 0.81) * white[:, n]
    return coloured


@pytest.mark.parametrize("kind", ["white", "coloured"])
def test_two_standard_deviations_cover_the_truth_as_often_as_they_should(kind: str) -> None:
    runs, count, length = 400, 100, 100
    generator = np.random.default_rng(11)
    # Columns as coloured as the noise: there ordinary least squares would claim far too much certainty.
    times = np.arange(count * length)
    excitation = np.stack(
        [np.sin(0.031 * times + 1e-6 * times**2), np.cos(0.047 * times), np.sign(np.sin(0.0531 * times))],
        axis=1,
    )
    rows = (excitation * SIZES).reshape(count, length, 3)
    disturbance = 0.3 * noise(kind, (runs, count * length), generator)
    covered = np.zeros(3)
    for run in range(runs):
        disturbed = disturbance[run].reshape(count, length)
        pairs = [(rows[n], rows[n] @ TRUTH + disturbed[n]) for n in range(count)]
        fit = regression(pairs, 0.025)
        covered += np.abs(fit.parameters - TRUTH) < 2.0 * fit.standard_deviations
    share = covered / runs
    assert ((share >= 0.90) & (share <= 0.98)).all(), share


def test_what_a_moving_parameter_does_to_the_others_is_known() -> None:
    """Of drag and dry friction at one frequency, at an amplitude that grows while the drag falls."""
    phase = 2.0 * np.pi * np.arange(200) / 100.0
    fit = RecursiveLeastSquares(np.ones(2), 0.025, noise=0.05)
    errors, stated = [], []
    for number in range(120):
        amplitude, drag = (0.1 + 0.01 * max(0, number - 40), 4.0 - 0.02 * max(0, number - 40))
        rows = np.array([amplitude * np.cos(phase), np.sign(np.cos(phase))]).T
        target = rows @ [drag, 0.3]
        if number == 20:
            fit.begin(np.array([4.0, 0.3]), (rows.T @ rows)[np.newaxis] * 20, np.zeros((2, 2)), np.zeros(2))
        elif number > 20:
            take(fit, rows, target)
            errors.append(abs(fit.parameters[1] - 0.3))
            stated.append(abs(fit.leaks[1, 0]))
    assert stated[19] == 0.0  # nothing moved yet
    assert errors[-1] > 0.02
    np.testing.assert_allclose(stated[50:], errors[50:], rtol=0.5)


def test_the_product_of_small_matrices_is_numpys() -> None:
    one, other = np.random.default_rng(0).standard_normal((2, 3, 3))
    np.testing.assert_allclose(times(one, other.T), one @ other.T, rtol=1e-14)
