"""Damped Gauss-Newton fit of a hypothesis by its free runs, with the deviations of its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import STEP, Stopping, Unknown
from spool_estimator.identification.least_squares import descend as least_squares
from spool_sim.terms import term

from spool_gap.simulation.point import Point
from spool_gap.simulation.simulate import Simulation

Array = NDArray[np.float64]

#: Share of the signal that a window may move by the step of a slope: more means a jump to another motion,
#: whose slope says nothing.
JUMP = 0.1
#: The steps with dry friction, whose laws differ by so little that a longer step bends more than it slopes,
#: and where that one leads no further: where the spool sticks and slips the sum of squares is rough.
ROUGH_STEPS = (1e-5, 1e-2)
#: A fall of the sum of squares below this share, or this number, ends the descent.
ENOUGH, LEAST_FALL = 2e-4, 1.0


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
    free: tuple[Unknown, ...]
    squares: float
    deviations: Mapping[str, float]
    correlation: Array
    at_bound: tuple[str, ...]
    settled: object | None = None


class HypothesisResiduals:
    """Weighted residuals of a hypothesis over the windows that are fitted; ``start`` gives what is held."""

    def __init__(self, simulation: Simulation, start: Point, unknowns: Sequence[Unknown]) -> None:
        self.unknowns = tuple(unknowns)
        self._names = [unknown.name for unknown in unknowns]
        self._simulation, self._start = simulation, start
        self._chosen = simulation.training
        measured = [row[np.newaxis] for row in simulation.measured(self._chosen)]
        self._most = JUMP * simulation.weigh(measured, self._chosen)[0]

    def residuals(self, points: Array) -> Array:
        """Return the weighted residuals at ``points`` (s, u), shape (s, m)."""
        moved = [self._start.moved(self._names, numbers.tolist()) for numbers in points]
        return self._simulation.weigh(self._simulation.errors(moved, self._chosen), self._chosen)

    def costs(self, residuals: Array) -> Array:
        """Return the sums of squares, bad windows by their logarithm where the simulation says so."""
        return self._simulation.cost(residuals, self._chosen)

    def trust(self, residual: Array, changes: Array) -> Array:
        """Return how far each number of ``residual`` (m,) counts: bad windows and jumps hardly."""
        trust = self._simulation.trust(residual, self._chosen)
        return trust * self._simulation.smooth(changes, self._most, self._chosen)


def descend(
    simulation: Simulation,
    starts: Sequence[Point],
    free: Sequence[Unknown],
    *,
    rounds: int = 8,
    tries: int = 1,
    enough: float = ENOUGH,
) -> Fitted:
    """Return the best fit from ``starts``, whose terms differ in ``free`` only; ``tries`` are followed."""
    problem = HypothesisResiduals(simulation, starts[0], free)
    rough = any(term(name).slides for name in starts[0].terms)
    stopping = Stopping(rounds, enough, LEAST_FALL, ROUGH_STEPS if rough else (STEP,))
    numbers = np.array([[start.get(unknown.name) for unknown in free] for start in starts])
    end = least_squares(problem, numbers, stopping, tries)
    covariance = np.asarray(np.linalg.pinv(end.information, rcond=1e-12, hermitian=True))
    # What the weight does not hold of the residual widens the intervals.
    inflation = max(1.0, end.cost / max(1, end.numbers - len(free)))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0) * inflation) * end.sizes
    scale = end.sizes / np.where(spread > 0.0, spread, 1.0)
    bound = tuple(
        unknown.name
        for unknown, value in zip(free, end.point.tolist(), strict=True)
        if min(value - unknown.low, unknown.high - value) <= 1e-6 * unknown.scale
    )
    at_rest = end.exhausted or (end.converged and enough <= ENOUGH)
    return Fitted(
        starts[end.start].moved([unknown.name for unknown in free], end.point.tolist()),
        tuple(free),
        end.cost,
        dict(zip((unknown.name for unknown in free), spread.tolist(), strict=True)),
        np.asarray(covariance * inflation * np.outer(scale, scale)),
        bound,
        simulation.weighing if at_rest else None,
    )
