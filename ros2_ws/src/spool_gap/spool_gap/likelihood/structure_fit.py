"""Fit of a structure's numbers by the likelihood of its prediction errors.

The correction begins loose, so that the errors are those of a regression along the measured motion and
have few minima, and is tightened step by step. The most likely fit counts: how loose the correction
should be is a property of the record, as its noise is.

Source of the update of slopes between steps: Broyden, 1965.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown

from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.structure import DELAY, GAIN, Spectrum, Structure

#: Looseness of the correction from the first to the last fit.
LOOSENESS = (1.0, 0.3, 0.1, 0.03, 0.01)
#: Looseness from which the delay of the spool's channel keeps its value: a motion that follows the measured
#: one hardly depends on it.
FOLLOWS = 0.3
#: Standard deviations of gain (relative) and delay (s) of the spool's channel: tolerances of 5 % and 0.5 ms
#: are about their 95 % limits.
PRIORS = {GAIN: 0.03, DELAY: 0.3e-3}
#: Steps of a fit, and rise of the log likelihood that ends it: a tenth of what a parameter costs.
STEPS, ENOUGH = 40, 0.5
#: Steps in a row that rise by less than that and end a fit, whatever the slopes promise.
PATIENCE = 4
#: Step of a number over its size for slopes, and of a number of the chain over its typical size.
STEP, CHAIN_STEP = 2e-4, 0.02
#: Largest change of a number in a step over its size.
LONGEST = 0.5
#: Share of the promised rise below which slopes are worked out again.
KEPT = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class StructureFit:
    """Fit of a structure.

    Attributes:
        structure: with the fitted numbers.
        log_likelihood: with the priors of gain and delay.
        unknowns: that were fitted; ``count``: of all that are free, these or others that were held here.
        looseness: of the correction at which it is most likely.
        lines: prediction errors there, of each part.
        numbers: count of real numbers that were compared.
        priors: 1 over the standard deviation that each number had before, 0 where it had none.
    """

    structure: Structure
    log_likelihood: float
    unknowns: list[Unknown]
    count: int
    looseness: float
    lines: list[Spectrum]
    numbers: float
    priors: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fitted numbers."""
        return tuple(one.name for one in self.unknowns)

    @property
    def evidence(self) -> float:
        """Log likelihood less the penalty of the fitted numbers (half of minus the BIC; Schwarz, 1978)."""
        return self.log_likelihood - 0.5 * self.count * math.log(self.numbers)


def fit_structure(
    predictions: Predictions,
    structure: Structure,
    looseness: Sequence[float] = LOOSENESS,
    *,
    named: frozenset[str] = frozenset(),
    held: frozenset[str] = frozenset(),
    steps: int = STEPS,
    enough: float = ENOUGH,
) -> StructureFit:
    """Return the most likely fit of ``structure``, which holds the start values.

    Args:
        predictions: of the record.
        structure: what is fitted.
        looseness: of the corrections, in order; the fit ends after two that are less likely than the best.
        named: gain or delay that need not keep to the tolerance of a data sheet.
        held: numbers that keep their values.
        steps: of each fit at most.
        enough: rise of the log likelihood that ends a fit.
    """
    best: StructureFit | None = None
    worse = 0
    for share in looseness:
        kept = held | {DELAY} if share >= FOLLOWS else held
        found = _fit(predictions, structure, share, named, frozenset(kept), steps, enough)
        structure = found.structure
        if best is None or found.log_likelihood > best.log_likelihood:
            best, worse = found, 0
        else:
            worse += 1
        if worse == 2:
            break
    assert best is not None
    return best


def _fit(
    predictions: Predictions,
    structure: Structure,
    looseness: float,
    named: frozenset[str],
    held: frozenset[str],
    most: int,
    enough: float,
) -> StructureFit:
    """Return the fit with one correction: Gauss-Newton steps, damped where the likelihood does not rise."""
    structure = structure.bounded(predictions.seconds)
    unknowns = [one for one in structure.unknowns(predictions.seconds) if one.name not in held]
    names = tuple(one.name for one in unknowns)
    priors = np.array([0.0 if n in named or n not in PRIORS else 1.0 / PRIORS[n] for n in names])
    lines = predictions.errors([structure], looseness)[0]
    point = np.array([structure.values[name] for name in names])
    likelihood = predictions.log_likelihood(lines) - 0.5 * float(np.sum((priors * point) ** 2))
    damping, fresh, slow = 1e-3, False, 0
    weights: list[Array] = []
    slopes: Array = np.empty((0, 0))
    for _ in range(most):
        if not fresh:
            weights = predictions.weights(lines)
            slopes = _slopes(predictions, structure, unknowns, looseness, lines, weights)
            fresh, renewed = True, True
        residual = predictions.weighed(lines, weights)
        change, promised = _step(slopes, residual, priors, point, damping)
        if promised < enough:
            if renewed:
                break
            fresh = False
            continue
        trial_point = _within(unknowns, point, change)
        trial = structure.moved(dict(zip(names, trial_point.tolist(), strict=True)))
        trial_lines = predictions.errors([trial], looseness)[0]
        value = predictions.log_likelihood(trial_lines) - 0.5 * float(np.sum((priors * trial_point) ** 2))
        rise = value - likelihood
        moved = trial_point - point
        if moved @ moved > 0.0:
            # Broyden: the slopes that explain the change of the errors along this step.
            scaled = moved / _sizes(unknowns, point) ** 2
            off = predictions.weighed(trial_lines, weights) - residual - moved @ slopes
            slopes = slopes + np.outer(scaled, off) / float(moved @ scaled)
        slow = slow + 1 if rise < enough else 0
        if rise > 0.0:
            structure, lines, likelihood, point = trial, trial_lines, value, trial_point
            damping *= 0.3
            renewed = False
            fresh = rise > KEPT * promised
        else:
            if renewed or damping > 1e-2:
                damping = 8.0 * damping + 1e-2
            else:
                fresh = False
            renewed = False
        if slow == PATIENCE:
            break
    return StructureFit(
        structure, likelihood, unknowns, len(structure.unknowns(predictions.seconds)), looseness, lines,
        predictions.numbers, priors,
    )  # fmt: skip


def judged(predictions: Predictions, fit: StructureFit) -> StructureFit:
    """Return ``fit`` with the errors and the likelihood of the samples that count now."""
    lines = predictions.errors([fit.structure], fit.looseness)[0]
    point = np.array([fit.structure.values[name] for name in fit.names])
    prior = 0.5 * float(np.sum((fit.priors * point) ** 2))
    return replace(
        fit,
        lines=lines,
        log_likelihood=predictions.log_likelihood(lines) - prior,
        numbers=predictions.numbers,
    )


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
    weights = predictions.weights(fit.lines)
    slopes = _slopes(predictions, fit.structure, fit.unknowns, fit.looseness, fit.lines, weights, widened)
    information = slopes @ slopes.T + np.diag(fit.priors**2)
    scales = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scales, scales), hermitian=True)
    return Curvature(slopes, covariance / np.outer(scales, scales))


def _slopes(
    predictions: Predictions,
    structure: Structure,
    unknowns: Sequence[Unknown],
    looseness: float,
    lines: Sequence[Spectrum],
    weights: Sequence[Array],
    widened: float = 1.0,
) -> Array:
    """Return the change of the weighed errors over each unknown, shape (u, numbers)."""
    steps = [widened * _step_size(one, structure.values[one.name]) for one in unknowns]
    points = [
        structure.moved({one.name: structure.values[one.name] + step})
        for one, step in zip(unknowns, steps, strict=True)
    ]
    moved = predictions.errors_near(structure, lines, points, looseness)
    here = predictions.weighed(lines, weights)
    return np.array(
        [(predictions.weighed(row, weights) - here) / step for row, step in zip(moved, steps, strict=True)]
    )


def _step(slopes: Array, residual: Array, priors: Array, point: Array, damping: float) -> tuple[Array, float]:
    """Return the damped Gauss-Newton step, and the rise of the log likelihood that it promises."""
    information = slopes @ slopes.T + np.diag(priors**2)
    gradient = slopes @ residual + priors**2 * point
    scales = np.sqrt(np.maximum(np.diag(information), 1e-300))
    matrix, scaled = information / np.outer(scales, scales), gradient / scales
    change = -np.linalg.lstsq(matrix + damping * np.eye(point.size), scaled, rcond=1e-12)[0]
    promised = -float(scaled @ change) - 0.5 * float(change @ matrix @ change)
    return change / scales, promised


def _step_size(unknown: Unknown, value: float) -> float:
    size = CHAIN_STEP * unknown.scale if unknown.absolute else STEP * max(abs(value), 0.05 * unknown.scale)
    return -size if value + size > unknown.high else size


def _sizes(unknowns: Sequence[Unknown], point: Array) -> Array:
    return np.array([one.size(value) for one, value in zip(unknowns, point.tolist(), strict=True)])


def _within(unknowns: Sequence[Unknown], point: Array, change: Array) -> Array:
    """Return the numbers after ``change`` (u,), within bounds and not too far at a time."""
    found = []
    for one, value, delta in zip(unknowns, point.tolist(), change.tolist(), strict=True):
        most = 5.0 * one.scale if one.absolute else LONGEST * max(abs(value), 0.1 * one.scale)
        found.append(min(max(value + min(max(delta, -most), most), one.low), one.high))
    return np.array(found)
