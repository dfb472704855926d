"""Fit of a structure's numbers by the likelihood of what it leaves.

Gauss-Newton steps, damped where the likelihood does not rise. The slopes come from runs with each number
changed a little, and are updated by what each step shows until that promises too much.

Source of the update: Broyden, A class of methods for solving nonlinear simultaneous equations, 1965.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.least_squares import Unknown
from spool_sim.observation import INSTANTS, Spectrum

from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.structure import DELAY, GAIN, Structure

#: Standard deviations of gain (relative) and delay (s) of the spool's channel: tolerances of 5 % and 0.5 ms
#: are about their 95 % limits.
PRIORS = {GAIN: 0.03, DELAY: 0.3e-3}
#: Steps of a fit, and rise of the log likelihood that ends it: a tenth of what a parameter costs.
STEPS, ENOUGH = 40, 0.5
#: Step of a number over its size for slopes, and of a number of the chain over its typical size.
STEP, CHAIN_STEP = 1e-3, 0.02
#: Largest change of a number in a step over its size.
LONGEST = 0.7
#: Share of the promised rise below which slopes are worked out again.
KEPT = 0.4
#: Damping of the first step, and from which a fit has ended.
FIRST, MOST = 1e-2, 1e4


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


def fit_structure(
    predictions: Predictions,
    structure: Structure,
    *,
    held: frozenset[str] = frozenset(),
    steps: int = STEPS,
    enough: float = ENOUGH,
) -> StructureFit:
    """Return the most likely fit of ``structure``, which holds the start values.

    Args:
        predictions: of the record.
        structure: what is fitted.
        held: numbers that keep their values.
        steps: at most.
        enough: rise of the log likelihood that ends it.
    """
    structure = structure.bounded(predictions.seconds)
    every = structure.unknowns(predictions.seconds)
    unknowns = [one for one in every if one.name not in held]
    names = tuple(one.name for one in unknowns)
    priors = np.array([1.0 / PRIORS[name] if name in PRIORS else 0.0 for name in names])
    lines = predictions.errors([structure])[0]
    point = np.array([structure.values[name] for name in names])
    likelihood = predictions.log_likelihood(lines) - 0.5 * float(np.sum((priors * point) ** 2))
    damping, fresh = FIRST, False
    slopes: list[Spectrum] = []
    for _ in range(steps if names else 0):
        if not slopes:
            slopes, fresh = _slopes(predictions, structure, unknowns, lines), True
        weights = predictions.weights(lines)
        rows, residual = predictions.weighed(slopes, weights), predictions.weighed(lines, weights)
        change, promised = _step(rows, residual, priors, point, damping)
        if promised < enough:
            if fresh:
                break
            slopes = []
            continue
        trial_point = _within(unknowns, point, change)
        moved = trial_point - point
        trial = structure.moved(dict(zip(names, trial_point.tolist(), strict=True)))
        trial_lines = predictions.errors([trial])[0]
        value = predictions.log_likelihood(trial_lines) - 0.5 * float(np.sum((priors * trial_point) ** 2))
        rise = value - likelihood
        if rise > 0.0:
            # The slopes that explain the change of the errors along this step.
            sizes = [one.size(value) for one, value in zip(unknowns, point.tolist(), strict=True)]
            scaled = moved / np.array(sizes) ** 2
            share = scaled / float(moved @ scaled)
            for place, rows_there in enumerate(slopes):
                off = trial_lines[place] - lines[place] - np.tensordot(moved, rows_there, 1)
                slopes[place] = rows_there + share[:, np.newaxis, np.newaxis] * off
            structure, lines, likelihood, point = trial, trial_lines, value, trial_point
            damping = max(0.2 * damping, 1e-9)
            if rise < KEPT * promised or rise < enough:
                if fresh and rise < enough:
                    break
                slopes = []
            fresh = False
        elif fresh:
            damping = 10.0 * damping + 1e-3
            if damping > MOST:
                break
        else:
            slopes = []
    return StructureFit(
        structure,
        likelihood,
        unknowns,
        len(every),
        lines,
        predictions.numbers,
        priors,
        predictions.left(lines),
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
    rows = _slopes(predictions, fit.structure, fit.unknowns, fit.lines, widened)
    slopes = predictions.weighed(rows, predictions.weights(fit.lines))
    information = slopes @ slopes.T + np.diag(fit.priors**2)
    scales = np.sqrt(np.maximum(np.diag(information), 1e-300))
    covariance = np.linalg.pinv(information / np.outer(scales, scales), hermitian=True)
    return Curvature(slopes, covariance / np.outer(scales, scales))


def _slopes(
    predictions: Predictions,
    structure: Structure,
    unknowns: Sequence[Unknown],
    lines: Sequence[Spectrum],
    widened: float = 1.0,
) -> list[Spectrum]:
    """Return the change of the errors over each unknown, (u, windows, lines) for each part."""
    steps = np.array([widened * _step_size(one, structure.values[one.name]) for one in unknowns])
    points = [
        structure.moved({one.name: structure.values[one.name] + step})
        for one, step in zip(unknowns, steps.tolist(), strict=True)
    ]
    if structure.observation.kind == INSTANTS:  # which samples count depends on the first structure
        rows = [part.errors([structure, *points]) for part in predictions.parts]
        lines, rows = [row[0] for row in rows], [row[1:] for row in rows]
    else:
        rows = [part.errors(points) for part in predictions.parts]
    return [(row - here) / steps[:, np.newaxis, np.newaxis] for row, here in zip(rows, lines, strict=True)]


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


def _within(unknowns: Sequence[Unknown], point: Array, change: Array) -> Array:
    """Return the numbers after ``change`` (u,), within bounds and not too far at a time."""
    found = []
    for one, value, delta in zip(unknowns, point.tolist(), change.tolist(), strict=True):
        most = 5.0 * one.scale if one.absolute else LONGEST * max(abs(value), 0.1 * one.scale)
        found.append(min(max(value + min(max(delta, -most), most), one.low), one.high))
    return np.array(found)
