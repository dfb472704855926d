"""Fit of a hypothesis by its free runs: damped Gauss-Newton, all slopes and steps of a round in one batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_sim.terms import term

from spool_gap.simulation.point import Point
from spool_gap.simulation.simulate import Simulation

from .parallel import at_once

Array = NDArray[np.float64]

DAMPINGS = (1e-3, 1.0)
#: Step of a number over its size for slopes, and the share of the signal that a window may move by it:
#: more means a jump to another motion, whose slope says nothing.
STEP, JUMP = 1e-3, 0.1
#: The steps with dry friction, whose laws differ by so little that a longer step bends more than it slopes,
#: and where that one leads no further: where the spool sticks and slips the sum of squares is rough.
FINE_STEP, LONG_STEP = 1e-5, 1e-2
#: A fall of the sum of squares below this share ends the descent.
ENOUGH = 2e-4


@dataclass(frozen=True, slots=True)
class Free:
    """A number that is fitted: bounds, typical size; ``absolute``: steps do not grow with it."""

    name: str
    low: float
    high: float
    scale: float
    absolute: bool = False

    def size(self, value: float) -> float:
        """Return the size of ``value`` that steps are taken in proportion to."""
        return self.scale if self.absolute else max(abs(value), 0.1 * self.scale)


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted hypothesis.

    Attributes:
        point: the numbers.
        free: what was fitted.
        squares: weighed sum of squares over the fitted windows.
        deviations: standard deviation of each fitted number.
        correlation: of the fitted numbers, shape (p, p).
        at_bound: names of numbers that stopped at a bound.
        settled: the weighing with which the descent came to rest, ``None`` where its rounds ran out.
    """

    point: Point
    free: tuple[Free, ...]
    squares: float
    deviations: Mapping[str, float]
    correlation: Array
    at_bound: tuple[str, ...]
    settled: object | None = None


def descend(
    simulation: Simulation,
    starts: Sequence[Point],
    free: Sequence[Free],
    *,
    rounds: int = 8,
    tries: int = 1,
    enough: float = ENOUGH,
) -> Fitted:
    """Return the best fit from ``starts`` (same terms); the best ``tries`` of them are followed."""
    chosen = simulation.training
    names = [entry.name for entry in free]
    low = np.array([entry.low for entry in free])
    high = np.array([entry.high for entry in free])
    inside = [
        start.moved(names, np.clip([start.get(name) for name in names], low, high).tolist())
        for start in starts
    ]
    residuals = simulation.weigh(simulation.errors(inside, chosen), chosen)
    squares = simulation.cost(residuals, chosen)
    found = at_once(
        lambda place: _follow(simulation, inside[place], residuals[place], free, rounds, enough),
        np.argsort(squares)[:tries].tolist(),
    )
    return min(found, key=lambda one: one.squares)


def _follow(
    simulation: Simulation, start: Point, residual: Array, free: Sequence[Free], rounds: int, enough: float
) -> Fitted:
    chosen = simulation.training
    names = [entry.name for entry in free]
    low = np.array([entry.low for entry in free])
    high = np.array([entry.high for entry in free])
    point, x = start, np.array([start.get(name) for name in names])
    squares = float(simulation.cost(residual[np.newaxis], chosen)[0])
    damping = 1.0
    signal = simulation.weigh([row[np.newaxis] for row in simulation.measured(chosen)], chosen)[0]
    information: Array = np.eye(len(names))
    scale: Array = np.ones(len(names))
    rough = any("sliding_law" in term(name).laws for name in start.active)
    reach, longest = (FINE_STEP, LONG_STEP) if rough else (STEP, STEP)
    settled = None
    for _ in range(rounds):
        scale = np.array([entry.size(value) for entry, value in zip(free, x.tolist(), strict=True)])
        step = reach * scale
        step = np.where(x + step > high, -step, step)
        moved = [point.moved(names, (x + step * unit).tolist()) for unit in np.eye(len(names))]
        runs = simulation.weigh(simulation.errors(moved, chosen), chosen)
        trust = simulation.trust(residual, chosen) * simulation.smooth(runs - residual, JUMP * signal, chosen)
        # In units of the numbers' sizes: stiffnesses and delays differ by ten powers of ten.
        slopes = ((runs - residual) * trust * (scale / step)[:, np.newaxis]).T
        information = slopes.T @ slopes
        gradient = slopes.T @ (trust * residual)
        limit = 0.7 * np.maximum(scale, [entry.scale for entry in free])
        trials = [
            np.clip(x + np.clip(change, -limit, limit), low, high)
            for change in _changes(information, gradient, damping, scale, (x <= low, x >= high))
        ]
        points = [point.moved(names, trial.tolist()) for trial in trials]
        outcomes = simulation.weigh(simulation.errors(points, chosen), chosen)
        sums = simulation.cost(outcomes, chosen)
        winner = int(np.argmin(sums))
        if not sums[winner] < squares:
            if damping <= 1e3:
                damping *= 1e3
            elif reach < longest:
                reach, damping = longest, 1.0
            else:
                settled = simulation.weighing
                break
            continue
        fall = squares - float(sums[winner])
        damping = float(np.clip(damping * DAMPINGS[winner] * 10.0, 1e-6, 1e3))
        point, x, residual, squares = points[winner], trials[winner], outcomes[winner], float(sums[winner])
        if fall < max(enough * squares, 1.0):
            if reach == longest:
                settled = simulation.weighing if enough <= ENOUGH else None
                break
            reach, damping = longest, 1.0
    found = _outcome(point, free, squares, information, scale, residual.size)
    return replace(found, settled=settled)


def _changes(
    information: Array, gradient: Array, damping: float, scale: Array, at: tuple[NDArray[np.bool_], ...]
) -> list[Array]:
    """Return the changes of the numbers for each of ``DAMPINGS``; ``at`` their low and high bounds."""
    diagonal = np.diag(information) + 1e-12 * np.trace(information)
    # What would leave its bounds stays there, and the others are solved for without it.
    held = (at[0] & (gradient > 0.0)) | (at[1] & (gradient < 0.0))
    own = np.flatnonzero(~held)
    found: list[Array] = []
    for factor in DAMPINGS:
        change = np.zeros(gradient.size)
        if own.size:
            matrix = information[np.ix_(own, own)] + np.diag(damping * factor * diagonal[own])
            change[own] = -scale[own] * np.linalg.lstsq(matrix, gradient[own], rcond=1e-12)[0]
        found.append(change)
    return found


def _outcome(
    point: Point, free: Sequence[Free], squares: float, information: Array, scale: Array, size: int
) -> Fitted:
    """Return where a descent ended; ``information`` in units of ``scale`` from ``size`` weighed numbers."""
    names = [entry.name for entry in free]
    covariance = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    # What the weight does not hold of the residual widens the intervals.
    inflation = max(1.0, squares / max(1, size - len(names)))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0) * inflation) * scale
    spread_ = np.where(spread > 0.0, spread, 1.0)
    correlation = covariance * inflation * np.outer(scale, scale) / np.outer(spread_, spread_)
    room = 1e-6 * np.array([entry.scale for entry in free])
    bound = tuple(
        n
        for n, entry, r in zip(names, free, room.tolist(), strict=True)
        if point.get(n) - entry.low <= r or entry.high - point.get(n) <= r
    )
    return Fitted(
        point, tuple(free), squares, dict(zip(names, spread.tolist(), strict=True)), correlation, bound
    )
