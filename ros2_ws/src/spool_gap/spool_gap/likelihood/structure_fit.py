"""Fit of a structure's numbers by the likelihood of its prediction errors.

The correction begins loose, so that the errors are those of a regression along the measured motion and
have few minima, and is tightened step by step. The most likely fit counts: how loose the correction
should be is a property of the record, as its noise is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.least_squares import Unknown

from .chain_part import DELAY, GAIN, Spectrum
from .prediction import Prediction, Structure

Array = NDArray[np.float64]

#: Looseness of the correction from the first to the last fit: half a decade each.
LOOSENESS = (1.0, 0.3, 0.1, 0.03, 0.01)
#: Standard deviations of gain (relative) and delay (s) of the spool's channel: tolerances of 5 % and 0.5 ms
#: are about their 95 % limits.
PRIORS = {GAIN: 0.03, DELAY: 0.3e-3}
#: Rounds of a fit, and rise of the log likelihood that ends it: a fifth of what a parameter costs.
ROUNDS, ENOUGH = 10, 0.5
#: Step of a number over its size for slopes, and of a number of the chain over its typical size.
STEP, CHAIN_STEP = 2e-3, 0.1
#: Largest change of a number in a round over its size.
LONGEST = 0.5


@dataclass(frozen=True, slots=True)
class StructureFit:
    """Fit of a structure.

    Attributes:
        structure: with the fitted numbers.
        log_likelihood: with the priors of gain and delay.
        count: of fitted numbers.
        deviations: standard deviation of each by its name, from the curvature of the likelihood.
        looseness: of the correction at which it is most likely.
        lines: prediction errors there, shape (windows, lines).
        numbers: count of real numbers that were compared.
    """

    structure: Structure
    log_likelihood: float
    count: int
    deviations: dict[str, float]
    looseness: float
    lines: Spectrum
    numbers: float

    @property
    def evidence(self) -> float:
        """Log likelihood less the penalty of the fitted numbers (half of minus the BIC; Schwarz, 1978)."""
        return self.log_likelihood - 0.5 * self.count * math.log(self.numbers)


def fit_structure(
    prediction: Prediction,
    structure: Structure,
    looseness: Sequence[float] = LOOSENESS,
    *,
    named: frozenset[str] = frozenset(),
) -> StructureFit:
    """Return the most likely fit of ``structure``, which holds the start values.

    Args:
        prediction: of the record.
        structure: what is fitted.
        looseness: of the corrections, in order; the fit ends after two that are less likely than the best.
        named: gain or delay that need not keep to the tolerance of a data sheet.
    """
    best: StructureFit | None = None
    worse = 0
    for share in looseness:
        found = _fit(prediction, structure, share, named)
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
    prediction: Prediction, structure: Structure, looseness: float, named: frozenset[str]
) -> StructureFit:
    """Return the fit with one correction: Gauss-Newton steps, damped where the likelihood does not rise."""
    unknowns = structure.unknowns(prediction.seconds)
    priors = {name: spread for name, spread in PRIORS.items() if name not in named}
    lines = prediction.errors([structure], looseness).lines[0]
    likelihood = prediction.log_likelihood(lines) + _prior(structure, priors)
    damping = 1e-3
    information: Array = np.eye(len(unknowns))
    scales: Array = np.ones(len(unknowns))
    for _ in range(ROUNDS):
        information, gradient, scales = _slopes(prediction, structure, unknowns, looseness, priors)
        rise = 0.0
        for _ in range(6):
            matrix = information + np.diag(damping * np.diag(information) + 1e-12)
            change = -np.linalg.lstsq(matrix, gradient, rcond=None)[0] / scales
            trial = structure.moved(_changed(structure, unknowns, change))
            trial_lines = prediction.errors([trial], looseness).lines[0]
            value = prediction.log_likelihood(trial_lines) + _prior(trial, priors)
            if value > likelihood:
                rise = value - likelihood
                structure, lines, likelihood = trial, trial_lines, value
                damping *= 0.2
                break
            damping = 8.0 * damping + 1e-3
        if rise < ENOUGH:
            break
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)), 0.0)) / scales
    deviations = {one.name: float(value) for one, value in zip(unknowns, spread, strict=True)}
    return StructureFit(
        structure, likelihood, len(unknowns), deviations, looseness, lines, prediction.numbers
    )


def _slopes(
    prediction: Prediction,
    structure: Structure,
    unknowns: Sequence[Unknown],
    looseness: float,
    priors: dict[str, float],
) -> tuple[Array, Array, Array]:
    """Return information and gradient in scaled unknowns, and the scales."""
    steps = np.array([_step(one, structure.values[one.name]) for one in unknowns])
    points = [structure]
    points += [
        structure.moved({one.name: structure.values[one.name] + step})
        for one, step in zip(unknowns, steps, strict=True)
    ]
    lines = prediction.errors(points, looseness).lines
    weights = prediction.weights(lines[0])
    residual = prediction.weighed(lines[0], weights)
    slopes = np.array([prediction.weighed(row - lines[0], weights) for row in lines[1:]])
    slopes /= steps[:, np.newaxis]
    scales = np.linalg.norm(slopes, axis=1) + 1e-30
    slopes /= scales[:, np.newaxis]
    information, gradient = slopes @ slopes.T, slopes @ residual
    for place, one in enumerate(unknowns):
        if one.name in priors:
            weight = 1.0 / (priors[one.name] * scales[place])
            information[place, place] += weight**2
            gradient[place] += structure.values[one.name] / priors[one.name] * weight
    return information, gradient, scales


def _step(unknown: Unknown, value: float) -> float:
    size = CHAIN_STEP * unknown.scale if unknown.absolute else STEP * max(abs(value), 0.05 * unknown.scale)
    return -size if value + size > unknown.high else size


def _changed(structure: Structure, unknowns: Sequence[Unknown], change: Array) -> dict[str, float]:
    """Return the numbers after ``change`` (u,), within bounds and not too far at a time."""
    found = {}
    for one, delta in zip(unknowns, change.tolist(), strict=True):
        value = structure.values[one.name]
        most = 5.0 * one.scale if one.absolute else LONGEST * max(abs(value), 0.1 * one.scale)
        found[one.name] = float(np.clip(value + np.clip(delta, -most, most), one.low, one.high))
    return found


def _prior(structure: Structure, priors: dict[str, float]) -> float:
    return -0.5 * sum((structure.values[name] / spread) ** 2 for name, spread in priors.items())
