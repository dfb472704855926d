"""Intervals of a fit's numbers, and the profile likelihoods that show what bounds them.

They are those of any fit (:func:`spool_estimator.identification.residuals.covariance_of`), each window of a
second a block. Where a force jumps, its instants scatter, and slopes over short steps seem to tell more than
they do: the wider interval of two lengths of step counts.

Sources: Murphy and van der Vaart, JASA 95, 2000 (profile likelihood); Raue and others, Bioinformatics 25,
2009 (what a profile shows).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.identification.determination import RISE_95, ProfileLikelihood, verdict_of
from spool_estimator.identification.residuals import covariance_of

from spool_gap.likelihood.prediction import Predictions
from spool_gap.likelihood.structure_fit import StructureFit, curvature_of, fit_structure

#: Lengths of the steps that slopes of intervals are taken over, in those of a fit.
WIDENED = (1.0, 10.0)
#: Rise of the log likelihood that ends the last fit: far below what moves a number by a standard deviation.
EXACT = 0.05

#: Standard deviations at which a number is held, until the likelihood has fallen enough: the first four show
#: a parabola where there is one, the last a number that is hardly bounded.
STEPS = (1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0)
#: Fall of twice the log likelihood at which a side ends.
FAR_ENOUGH = 1.5 * RISE_95


@dataclass(frozen=True, slots=True)
class Numbers:
    """Fitted numbers with their intervals.

    Attributes:
        quantities: each with its standard deviation, in the order of the fit.
        correlation: shape (p, p).
        dispersion: how many times the windows' pulls scatter more than chance allows, in power, 1 at least.
    """

    quantities: tuple[Quantity, ...]
    correlation: Array
    dispersion: float

    def of(self, name: str) -> Quantity | None:
        """Return the number called ``name``, ``None`` where it was not fitted."""
        return next((one for one in self.quantities if one.name == name), None)

    def united(self, fits: Sequence[StructureFit]) -> Numbers:
        """Return these with intervals that reach to what other ``fits`` say of the same numbers.

        The largest difference is added in squares, as that of other corrections is.
        """
        found = []
        for one in self.quantities:
            others = [fit.structure.values[one.name] for fit in fits if one.name in fit.names]
            moved = max((abs(other - one.value) for other in others), default=0.0)
            found.append(replace(one, standard_deviation=math.hypot(one.standard_deviation, moved)))
        return replace(self, quantities=tuple(found))

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation by name."""
        return {one.name: one.standard_deviation for one in self.quantities}


def numbers_of(predictions: Predictions, fit: StructureFit) -> Numbers:
    """Return the numbers of ``fit`` with their intervals, as of any fit (:func:`covariance_of`)."""
    residual = predictions.weighed(fit.lines, predictions.weights(fit.lines))
    windows = _windows(predictions)
    found = []
    for widened in WIDENED:
        slopes = curvature_of(predictions, fit, widened).slopes
        priors = np.diag(fit.priors)
        found.append(covariance_of(np.concatenate([slopes.T, priors]), residual, windows))
    spread = np.sqrt(np.max([np.diag(one) for one, _ in found], axis=0))
    quantities = tuple(
        Quantity(one.name, one.unit, fit.structure.values[one.name], float(deviation), Validity.VALID)
        for one, deviation in zip(fit.unknowns, spread, strict=True)
    )
    covariance, dispersion = found[0]
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = np.clip(covariance / np.outer(size, size), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return Numbers(quantities, correlation, dispersion)


def profiles_of(
    predictions: Predictions, fit: StructureFit, numbers: Numbers, names: Sequence[str]
) -> tuple[ProfileLikelihood, ...]:
    """Return the profile likelihoods of the fitted numbers ``names`` of ``fit``.

    Rises are divided by the dispersion, so that a profile agrees with the interval near its lowest point.
    """
    known = [name for name in names if numbers.deviations.get(name, 0.0) > 0.0]
    return tuple(_profile(predictions, fit, numbers, name) for name in known)


def refined(predictions: Predictions, fit: StructureFit) -> tuple[StructureFit, Numbers]:
    """Return ``fit`` fitted to its end, and its numbers."""
    again = fit_structure(predictions, fit.structure, enough=EXACT)
    return again, numbers_of(predictions, again)


def _windows(predictions: Predictions) -> list[NDArray[np.int64]]:
    """Return the places of each window that counts among the weighed numbers."""
    found: list[NDArray[np.int64]] = []
    begin = 0
    for part in predictions.parts:
        shape = 2, int(part.inside.sum()), part.lines.size
        places = begin + np.arange(math.prod(shape)).reshape(shape)
        found += [places[:, window].ravel() for window in range(shape[1])]
        begin += places.size
    return found


def _profile(predictions: Predictions, fit: StructureFit, numbers: Numbers, name: str) -> ProfileLikelihood:
    unknown = next(one for one in fit.unknowns if one.name == name)
    best = fit.structure.values[name]
    rows = [(best, 0.0)]
    partners: dict[str, float] = {}
    for side in (-1.0, 1.0):
        for value, rise, held in _side(predictions, fit, numbers, name, side):
            rows.append((value, rise))
            for other in numbers.quantities:
                if other.name != name and other.standard_deviation > 0.0:
                    moved = abs(held.structure.values[other.name] - fit.structure.values[other.name])
                    size = moved / other.standard_deviation
                    partners[other.name] = max(partners.get(other.name, 0.0), size)
    rows.sort()
    partner = max(partners, key=lambda one: partners[one], default="")
    values, rises = zip(*rows, strict=True)
    return verdict_of(name, unknown.unit, tuple(values), tuple(rises), best, partner)


def _side(
    predictions: Predictions, fit: StructureFit, numbers: Numbers, name: str, side: float
) -> Iterator[tuple[float, float, StructureFit]]:
    unknown = next(one for one in fit.unknowns if one.name == name)
    place = [one.name for one in numbers.quantities].index(name)
    spread, best = numbers.deviations[name], fit.structure.values[name]
    # The likelihood's own width near its maximum, to which the interval is compared.
    own = math.sqrt(max(curvature_of(predictions, fit).covariance[place, place], 1e-300))
    widened = max(1.0, (spread / own) ** 2)
    start = fit.structure
    for step in STEPS:
        value = min(max(best + side * step * spread, unknown.low), unknown.high)
        held = fit_structure(predictions, start.moved({name: value}), held=frozenset({name}), steps=6)
        rise = max(0.0, 2.0 * (fit.log_likelihood - held.log_likelihood) / widened)
        yield value, rise, held
        start = held.structure
        if rise > FAR_ENOUGH or value in (unknown.low, unknown.high):
            return
