"""Fit of a structure's numbers by the likelihood of what it leaves.

It descends as every fit does (:mod:`spool_estimator.identification.least_squares`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import LeastSquares, Unknown, descend, proposed, sizes_of
from spool_sim.observation import INSTANTS, Spectrum

from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.structure import DELAY, GAIN, Structure

#: Standard deviations of gain (relative) and delay (s) of the spool's channel: tolerances of 5 % and 0.5 ms
#: are about their 95 % limits.
PRIORS = {GAIN: 0.03, DELAY: 0.3e-3}
#: Steps of a fit, and rise of the log likelihood that ends it: a tenth of what a parameter costs.
STEPS, ENOUGH = 40, 0.5
#: Damping of the first step: structures start where brief fits of others ended.
DAMPING = 1e-2
#: Evidence (log likelihood less its penalty) from which a component stays: twice what counts as decisive
#: (Kass and Raftery, 1995), since many are tried.
DECISIVE = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class StructureFit:
    """Fit of a structure.

    Attributes:
        structure: with the fitted numbers.
        log_likelihood: with the priors of gain and delay.
        unknowns: that were fitted; ``count``: of all that are free, these or others that were held here.
        lines: the errors, of each part.
        numbers: count of real numbers that were compared.
        priors: 1 over the standard deviation that each number had before, 0 where it had none.
        left: rms of the errors over that of the reading, where both count.
    """

    structure: Structure
    log_likelihood: float
    unknowns: list[Unknown]
    count: int
    lines: list[Spectrum]
    numbers: float
    priors: Array
    left: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted numbers."""
        return tuple(one.name for one in self.unknowns)

    def ratio(self, other: StructureFit) -> float:
        """Return the level that this leaves over that of ``other``, in the geometric mean of all tiles."""
        return math.exp((other.log_likelihood - self.log_likelihood) / max(self.numbers, 1.0))

    def beyond(self, other: StructureFit) -> float:
        """Return what this explains beyond ``other``, share of the spool's acceleration, rms."""
        return other.left * math.sqrt(max(0.0, 1.0 - self.ratio(other) ** 2))

    @property
    def evidence(self) -> float:
        """Log likelihood less the penalty of the fitted numbers (half of minus the BIC; Schwarz, 1978)."""
        return self.log_likelihood - 0.5 * self.count * math.log(self.numbers)


class _Likelihood(LeastSquares):
    """Minus twice the log likelihood of what a structure leaves, with the priors of gain and delay.

    A residual has the errors of all parts, one behind the other, and the numbers over their priors.
    """

    def __init__(
        self, predictions: Predictions, structure: Structure, unknowns: Sequence[Unknown], priors: Array
    ) -> None:
        self.unknowns, self.priors = tuple(unknowns), priors
        self.anchored = structure.observation.kind == INSTANTS  # the first decides which samples count
        self._predictions, self._structure = predictions, structure
        self._shapes = [(part.windows, part.lines.size) for part in predictions.parts]
        self._ends = np.cumsum([windows * lines for windows, lines in self._shapes]).tolist()

    def at(self, point: Array) -> Structure:
        """Return the structure at ``point`` (u,)."""
        names = (one.name for one in self.unknowns)
        return self._structure.moved(dict(zip(names, point.tolist(), strict=True)))

    def residuals(self, points: Array) -> Spectrum:
        """Return the errors at ``points`` (s, u) and the numbers over their priors, shape (s, m)."""
        structures = [self.at(point) for point in points]
        rows = [part.errors(structures).reshape(len(points), -1) for part in self._predictions.parts]
        return np.concatenate([*rows, (points * self.priors).astype(np.complex128)], axis=1)

    def lines(self, rows: Spectrum) -> list[Spectrum]:
        """Return the errors of each part in ``rows`` (..., m), shape (..., windows, lines)."""
        parts = np.split(rows[..., : self._ends[-1]], self._ends[:-1], axis=-1)
        return [
            part.reshape(*rows.shape[:-1], *shape) for part, shape in zip(parts, self._shapes, strict=True)
        ]

    def costs(self, residuals: Spectrum) -> Array:
        """Return minus twice the log likelihood of ``residuals`` (s, m), shape (s,)."""
        priors = np.sum(residuals[:, self._ends[-1] :].real ** 2, axis=1)
        found = [self._predictions.log_likelihood(self.lines(row)) for row in residuals]
        return np.asarray(priors - 2.0 * np.array(found))

    def weighed(self, rows: Spectrum, residual: Spectrum) -> Array:
        """Return ``rows`` (..., m) over the levels of ``residual`` (m,), the priors' last, shape (..., n)."""
        weights = self._predictions.weights(self.lines(residual))
        errors = self._predictions.weighed(self.lines(rows), weights)
        return np.concatenate([errors, rows[..., self._ends[-1] :].real], axis=-1)


def _posed(
    predictions: Predictions, structure: Structure, unknowns: Sequence[Unknown]
) -> tuple[_Likelihood, Array]:
    priors = np.array([1.0 / PRIORS[one.name] if one.name in PRIORS else 0.0 for one in unknowns])
    point = np.array([structure.values[one.name] for one in unknowns])
    return _Likelihood(predictions, structure, unknowns, priors), point


class Beside:
    """Numbers that structures share with one that is known, as they meet the record beside others.

    What joins takes over part of what these stood for, as drag that falls does of the mean drag. They follow
    to the first order, from the slopes at the known structure.
    """

    def __init__(self, predictions: Predictions, own: Structure) -> None:
        """Take the slopes at ``own``, one run for each of its numbers."""
        own = own.bounded(predictions.seconds)
        self._predictions, self._unknowns = predictions, own.unknowns(predictions.seconds)
        problem, point = _posed(predictions, own, self._unknowns)
        self._slopes = problem.slopes(point, problem.residuals(point[np.newaxis])[0])

    def met(self, one: Structure, errors: Sequence[Spectrum]) -> Structure:
        """Return ``one``, which leaves ``errors`` of each part, with the numbers that leave least."""
        names = {each.name for each in one.unknowns(self._predictions.seconds)}
        kept = [place for place, each in enumerate(self._unknowns) if each.name in names]
        unknowns = [self._unknowns[place] for place in kept]
        problem, point = _posed(self._predictions, one, unknowns)
        residual = np.concatenate([*(each.ravel() for each in errors), point * problem.priors])
        slopes = np.concatenate(
            [self._slopes[kept][:, : residual.size - point.size], np.diag(problem.priors)], axis=1
        )
        sizes = sizes_of(unknowns, point)
        return problem.at(
            proposed(problem, point, sizes, slopes * sizes[:, np.newaxis], residual, DAMPING)[0]
        )


def fit_structure(
    predictions: Predictions,
    structure: Structure,
    *,
    held: frozenset[str] = frozenset(),
    steps: int = STEPS,
    enough: float = ENOUGH,
    goal: float = -math.inf,
) -> StructureFit:
    """Return the most likely fit of ``structure``, which holds the start values.

    Args:
        predictions: of the record.
        structure: what is fitted.
        held: numbers that keep their values.
        steps: at most.
        enough: rise of the log likelihood that ends it.
        goal: log likelihood; a fit that does not come to it at its largest pace so far ends.
    """
    structure = structure.bounded(predictions.seconds)
    every = structure.unknowns(predictions.seconds)
    unknowns = [one for one in every if one.name not in held]
    problem, point = _posed(predictions, structure, unknowns)
    end = descend(
        problem, point[np.newaxis], steps, 2.0 * enough, relative=False, damping=DAMPING, goal=-2.0 * goal
    )
    lines = problem.lines(end.residual)
    return StructureFit(
        problem.at(end.point), -0.5 * end.cost, unknowns, len(every), lines, predictions.numbers,
        problem.priors, predictions.left(lines),
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Curvature:
    """Curvature of the likelihood at a fit.

    Attributes:
        slopes: of the weighed errors over each fitted number, shape (p, numbers).
        covariance: of the numbers, shape (p, p).
    """

    slopes: Array
    covariance: Array


def curvature_of(predictions: Predictions, fit: StructureFit, widened: float = 1.0) -> Curvature:
    """Return the curvature of the likelihood at ``fit``, with slopes over steps ``widened`` times as long."""
    problem = _Likelihood(predictions, fit.structure, fit.unknowns, fit.priors)
    point = np.array([fit.structure.values[name] for name in fit.names])
    residual = np.concatenate([*(one.ravel() for one in fit.lines), point * fit.priors])
    rows = problem.weighed(problem.slopes(point, residual, widened), residual)
    information = rows @ rows.T
    scales = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scales, scales), hermitian=True)
    return Curvature(rows[:, : -point.size], covariance / np.outer(scales, scales))
