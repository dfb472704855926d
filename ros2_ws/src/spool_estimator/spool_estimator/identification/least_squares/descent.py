"""Damped Gauss-Newton descent (Levenberg, Marquardt) within bounds, for residuals that run in batches.

The slopes of all unknowns are one batch of simulations, and so are the trials of all dampings. With
``scipy.optimize.least_squares``, which runs its trials singly, fits take 1.4 times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .parallel import in_parallel
from .unknown import Unknown, bounds_of, sizes_of

Array = NDArray[np.float64]

#: Dampings that are tried together, over the present one; its first, least and largest value, and the factor
#: on it where no trial falls.
DAMPINGS = (1e-3, 1.0)
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING, BACK_OFF = 1.0, 1e-6, 1e3, 1e3
#: Largest change of an unknown in one round, over its size.
LONGEST_STEP = 0.7
#: Step of an unknown over its size for slopes.
STEP = 1e-3


class LeastSquares(Protocol):
    """Least-squares problem: weighted residuals of several points together."""

    @property
    def unknowns(self) -> Sequence[Unknown]:
        """What is fitted, the order of every point."""

    def residuals(self, points: Array) -> Array:
        """Return the weighted residuals at ``points`` (s, u), shape (s, m)."""

    def costs(self, residuals: Array) -> Array:
        """Return what is made small, from ``residuals`` (s, m), shape (s,)."""

    def trust(self, residual: Array, changes: Array) -> Array | float:
        """Return how far each of ``residual`` (m,) counts; ``changes`` (u, m) are those by the steps."""


@dataclass(frozen=True, slots=True)
class Stopping:
    """Stopping rule of a descent.

    Attributes:
        rounds: after which it ends without having converged.
        enough: fall of the cost, as a share of it, below which it has converged.
        least: the same as a number.
        steps: over the size, for slopes; where one leads no further the next is tried.
    """

    rounds: int
    enough: float
    least: float = 0.0
    steps: tuple[float, ...] = (STEP,)


@dataclass(frozen=True, slots=True)
class Descent:
    """End of a descent.

    Attributes:
        start: number of the start that led there.
        point: shape (u,).
        cost: there.
        converged: no more falls, or by too little to go on.
        exhausted: no step falls at all.
        information: normal matrix of the last slopes, in unknowns over ``sizes``, shape (u, u).
        sizes: shape (u,).
        numbers: length of the residual.
    """

    start: int
    point: Array
    cost: float
    converged: bool
    exhausted: bool
    information: Array
    sizes: Array
    numbers: int


def descend(problem: LeastSquares, starts: Array, stopping: Stopping, tries: int = 1) -> Descent:
    """Return the deepest end of the descents from the best ``tries`` of ``starts`` (s, u)."""
    starts = np.clip(starts, *bounds_of(problem.unknowns))
    residuals = problem.residuals(starts)
    order = np.argsort(problem.costs(residuals))[:tries]

    def followed(place: int) -> Descent:
        return _follow(problem, place, starts[place], residuals[place], stopping)

    found = in_parallel(followed, order.tolist())
    return min(found, key=lambda one: one.cost)


def _follow(problem: LeastSquares, start: int, x: Array, residual: Array, stopping: Stopping) -> Descent:
    low, high = bounds_of(problem.unknowns)
    typical = np.array([unknown.scale for unknown in problem.unknowns])
    damping = FIRST_DAMPING
    cost = float(problem.costs(residual[np.newaxis])[0])
    information: Array = np.eye(x.size)
    sizes: Array = np.ones(x.size)
    converged = exhausted = not x.size
    reaches = list(stopping.steps)
    for _ in range(stopping.rounds if x.size else 0):
        sizes = sizes_of(problem.unknowns, x)
        step = reaches[0] * sizes
        step = np.where(x + step > high, -step, step)
        changes = problem.residuals(x + np.diag(step)) - residual
        trust = problem.trust(residual, changes)
        # In units of the unknowns' sizes: stiffnesses and delays differ by ten powers of ten.
        slopes = (changes * trust * (sizes / step)[:, np.newaxis]).T
        information = slopes.T @ slopes
        gradient = slopes.T @ (trust * residual)
        limit = LONGEST_STEP * np.maximum(sizes, typical)
        # What would leave its bounds stays there, and the others are solved for without it.
        held = ((x <= low) & (gradient > 0.0)) | ((x >= high) & (gradient < 0.0))
        moves = _changes(information, gradient, damping, np.flatnonzero(~held))
        trials = np.array([np.clip(x + np.clip(sizes * move, -limit, limit), low, high) for move in moves])
        outcomes = problem.residuals(trials)
        costs = problem.costs(outcomes)
        winner = int(np.argmin(costs))
        if not costs[winner] < cost:
            if damping <= MOST_DAMPING:
                damping *= BACK_OFF
            elif len(reaches) > 1:
                reaches, damping = reaches[1:], FIRST_DAMPING
            else:
                converged = exhausted = True
                break
            continue
        fall = cost - float(costs[winner])
        damping = float(np.clip(damping * DAMPINGS[winner] * 10.0, LEAST_DAMPING, MOST_DAMPING))
        x, residual, cost = trials[winner], outcomes[winner], float(costs[winner])
        if fall < max(stopping.enough * cost, stopping.least):
            if len(reaches) == 1:
                converged = True
                break
            reaches, damping = reaches[1:], FIRST_DAMPING
    return Descent(start, x, cost, converged, exhausted, information, sizes, residual.size)


def _changes(information: Array, gradient: Array, damping: float, own: NDArray[np.intp]) -> list[Array]:
    """Return the changes over the unknowns' sizes for each of ``DAMPINGS``; 0 but for those in ``own``."""
    diagonal = np.diag(information) + 1e-12 * np.trace(information)
    found: list[Array] = []
    for factor in DAMPINGS:
        change = np.zeros(gradient.size)
        if own.size:
            matrix = information[np.ix_(own, own)] + np.diag(damping * factor * diagonal[own])
            change[own] = -np.linalg.lstsq(matrix, gradient[own], rcond=1e-12)[0]
        found.append(change)
    return found
