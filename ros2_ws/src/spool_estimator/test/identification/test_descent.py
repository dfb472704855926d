"""Descent: it ends where scipy's least squares does, on bounds as within them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from spool_estimator.identification.least_squares import (
    Descent,
    LeastSquares,
    Unknown,
    bounds_of,
    descend,
    to_hold,
    unseen_directions,
)
from spool_estimator.identification.residuals import Weighted

TIME = np.linspace(0.0, 1.0, 200)
#: Size, rate and offset of a decay.
UNKNOWNS = (
    Unknown("size", "m", 0.0, 10.0, 1.0),
    Unknown("rate", "1/s", 0.1, 50.0, 5.0),
    Unknown("offset", "m", -1.0, 1.0, 0.1),
)


class Decay(LeastSquares):
    """A decay with noise, a least-squares problem as fits pose them."""

    def __init__(self, truth: Sequence[float], seed: int) -> None:
        self.unknowns = UNKNOWNS
        noise = np.random.default_rng(seed).normal(0.0, 0.01, TIME.size)
        self.measured = self.model(np.array([truth]))[0] + noise

    @staticmethod
    def model(points):
        size, rate, offset = points.T[:, :, np.newaxis]
        return size * np.exp(-rate * TIME) + offset

    def residuals(self, points):
        return self.model(points) - self.measured

    def costs(self, residuals):
        return np.sum(residuals**2, axis=1)


def found(problem: Decay, starts: Sequence[Sequence[float]], tries: int = 1) -> Descent:
    # Slopes by differences end here: a closer end takes hundreds of rounds where the residual is large.
    return descend(problem, np.array(starts), 200, 1e-9, tries)


@given(
    size=st.floats(0.5, 5.0), rate=st.floats(5.0, 20.0), offset=st.floats(-2.0, 2.0), seed=st.integers(0, 999)
)
@example(size=1.0, rate=11.0, offset=-1.75, seed=0)
@settings(max_examples=40, deadline=None)
def test_scipy_falls_no_further_from_its_end_be_that_on_a_bound(size, rate, offset, seed):
    """Beyond the bounds of the offset a problem has several ends; within them it has that of any start."""
    problem = Decay((size, rate, offset), seed)
    start = (1.0, 5.0, 0.0)
    end = found(problem, [start])
    for begin in (end.point, start) if abs(offset) < 0.9 else (end.point,):
        other = least_squares(
            lambda x: problem.residuals(x[np.newaxis])[0], begin, bounds=bounds_of(UNKNOWNS)
        )
        assert end.cost <= 2.0 * other.cost * (1.0 + 1e-6)
    assert end.converged
    assert np.all((end.point >= bounds_of(UNKNOWNS)[0]) & (end.point <= bounds_of(UNKNOWNS)[1]))


def test_the_deepest_of_several_ends_is_taken():
    problem = Decay((2.0, 8.0, 0.1), 1)
    end = found(problem, [(9.0, 0.1, -1.0), (2.0, 7.0, 0.0)], tries=2)
    assert end.cost <= min(found(problem, [start]).cost for start in ((9.0, 0.1, -1.0), (2.0, 7.0, 0.0)))


class Diverging(Decay):
    """A decay whose residual grows beyond the square root of the largest number from a size of 3 on."""

    def residuals(self, points):
        return np.where(points[:, :1] > 3.0, 1e200, super().residuals(points))

    costs = Weighted.costs


def test_a_descent_beside_motions_too_large_to_square_ends_without_an_error():
    problem = Diverging((5.0, 8.0, 0.1), 1)
    end = found(problem, [(2.999, 8.0, 0.1)])
    assert math.isfinite(end.cost)
    assert end.point[0] <= 3.0
    assert problem.costs(np.array([[1e200]])) == math.inf


def test_nothing_to_find_is_found_immediately():
    problem = Decay((2.0, 8.0, 0.1), 3)
    problem.unknowns = ()
    problem.residuals = lambda points: np.ones((points.shape[0], 4))
    end = descend(problem, np.empty((1, 0)), 5, 1e-6)
    assert end.converged
    assert end.cost == 4.0


@given(st.integers(0, 10_000), st.lists(st.integers(1, 3), min_size=1, max_size=3))
@settings(max_examples=100, deadline=None)
def test_with_what_is_held_the_data_determine_the_rest(seed, sizes):
    """The data tell one product of each group, so that all of it but one are held, wherever they stand."""
    generator = np.random.default_rng(seed)
    group = generator.permutation(np.repeat(np.arange(len(sizes)), sizes))
    slopes = generator.normal(size=(50, len(sizes)))[:, group] * generator.uniform(0.5, 2.0, group.size)
    scales = np.ones(group.size)
    held = to_hold(unseen_directions(slopes, scales), [f"u{place}" for place in range(group.size)])
    free = [place for place in range(group.size) if f"u{place}" not in held]
    assert sorted(group[free]) == list(range(len(sizes)))
    assert unseen_directions(slopes[:, free], scales[free]).size == 0
    assert free == [int(np.flatnonzero(group == one)[0]) for one in dict.fromkeys(group.tolist())]


def test_what_is_told_by_itself_is_never_held():
    unseen = np.array([[0.6, 0.0, 0.8, 0.0], [0.0, 0.0, 0.6, 0.8]])
    assert to_hold(unseen, ["a", "b", "c", "d"]) == ("d", "c")
    assert to_hold(unseen[:1], ["a", "b", "c", "d"]) == ("c",)
    assert to_hold(np.empty((0, 4)), ["a", "b", "c", "d"]) == ()
