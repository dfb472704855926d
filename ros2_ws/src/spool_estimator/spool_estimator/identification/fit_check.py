"""Check of a fit: what its records determine, before it begins and at its result."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Z_95
from spool_sim.model import Model
from spool_sim.valve import Valve

from spool_estimator.identification import least_squares
from spool_estimator.identification.determination import (
    IDENTIFIABLE,
    NOT,
    RISE_95,
    TOGETHER,
    UNDECIDED,
    Determination,
    by_information,
    crossing,
    hidden_by_name,
    judgement,
)
from spool_estimator.identification.equation_error import EquationError
from spool_estimator.identification.fit_result import FILTER, MASS, SPOOL_DELAY, SPOOL_GAIN, FitSettings
from spool_estimator.identification.free_run import FreeRun
from spool_estimator.identification.residuals import Residuals, Weighted

#: Standard deviations, each at most its size, at which a weak number is held until the likelihood fell.
STEPS = (1.0, 2.0, 3.0, 5.0, 10.0)
#: Rise over that at the end of an interval, and of a parabola over the profile, up to which the end is
#: interpolated; halvings on the way there.
NEAR, HALVINGS = 3.0, 8
#: Rise where a run failed.
FAILED = 1e300
#: Rounds of the fit of the others at each, and the fall of the cost that ends it.
ROUNDS, ENOUGH = 12, 1e-6


class UnusedParameterError(InputError):
    """A parameter that its model's law does not use."""


#: Factors on the excitation at which a parameter must show somewhere, or its law does not use it: from hardly
#: moving to far beyond what a machine does.
EXCITATIONS = (0.01, 0.1, 1.0, 10.0, 100.0)


def before_fit(
    run: FreeRun,
    unknowns: Sequence[least_squares.Unknown],
    point: Array,
    values: Mapping[str, float],
    settings: FitSettings,
) -> list[Determination]:
    """Return the judgement at the start values ``point`` (u,); all that is left there counts as noise.

    It is worked out on the windows of ``run``, and holds for as much data as these are.
    """
    residuals = Residuals(run, unknowns, values, (settings.low_cut, settings.high_cut))
    residuals.take_spectrum(residuals.differences(residuals.respond(point[np.newaxis])))
    hidden = hidden_at(run, unknowns, point, values, settings)
    return by_information(unknowns, point, residuals.central_slopes(point), hidden)


def at_result(
    residuals: Weighted,
    unknowns: Sequence[least_squares.Unknown],
    point: Array,
    covariance: Array,
    hidden: Mapping[str, tuple[str, ...]],
    first: Sequence[Determination],
) -> list[Determination]:
    """Return the judgement at the end of a descent.

    Args:
        residuals: weighed by their spectrum; its u unknowns were fitted.
        unknowns: all that are judged.
        point: where the descent ended, shape (u,).
        covariance: of the fit, shape (u, u).
        hidden: numbers that nothing shows by themselves, as of ``hidden_by_name``.
        first: the judgement before the fit.
    """
    slopes = residuals.central_slopes(point)
    own = dict(
        zip(
            (unknown.name for unknown in residuals.unknowns),
            by_information(residuals.unknowns, point, slopes, hidden, covariance),
            strict=True,
        )
    )
    spreads = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    alone = np.diag(np.linalg.pinv(slopes.T @ slopes))
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(np.isfinite(spreads) & (alone > 0.0), spreads**2 / alone, 1.0)
    dispersions = np.maximum(1.0, excess)
    rises = _rises_beyond(residuals, point, covariance) / dispersions
    for place, (name, one) in enumerate(own.items()):
        misled = bool(rises[place] < RISE_95)
        # A sensor's numbers have bounds that are no limits of physics.
        if (
            (misled or one.verdict != IDENTIFIABLE)
            and not hidden.get(name)
            and name not in (SPOOL_GAIN, SPOOL_DELAY, *FILTER)
        ):
            spread = math.inf if misled else float(spreads[place])
            own[name] = by_profile(residuals, point, one, spread, float(dispersions[place]))
    for unknown in unknowns:
        if unknown.name in own:
            continue
        if hidden.get(unknown.name):
            own[unknown.name] = judgement(unknown, None, None, hidden[unknown.name])
        elif unknown.name not in (SPOOL_GAIN, SPOOL_DELAY):
            # No slope at all, as of a stop that was not reached: a nearer one would show.
            wider = copy.copy(residuals)
            wider.unknowns = (*residuals.unknowns, unknown)
            blind = judgement(unknown, None, None, ())
            wide = np.append(point, residuals.values[unknown.name])
            own[unknown.name] = by_profile(wider, wide, blind, math.inf, 1.0)
    return [replace(own.get(one.name, one), at_start=one.verdict) for one in first]


def _rises_beyond(residuals: Weighted, point: Array, covariance: Array) -> Array:
    """Return how far the likelihood fell at twice the interval that ``covariance`` gives, shape (u,).

    The lesser of both sides, the others moved along; infinite where there is no interval. Where it is less
    than at the end of an interval, as above a friction that holds the spool, the slopes at ``point`` mislead.
    """
    variances = np.diag(covariance)
    places = np.flatnonzero(np.isfinite(variances) & (variances > 0.0))
    found = np.full(point.size, math.inf)
    if places.size:
        ways = 2.0 * Z_95 * covariance[places] / np.sqrt(variances[places, np.newaxis])
        points = np.vstack([point, point + ways, point - ways])
        points = np.clip(points, *least_squares.bounds_of(residuals.unknowns))
        costs = residuals.costs(residuals.residuals(points))
        found[places] = (costs[1:] - costs[0]).reshape(2, places.size).min(axis=0)
    return found


def scale_of(
    run: FreeRun,
    unknowns: Sequence[least_squares.Unknown],
    values: Mapping[str, float],
    settings: FitSettings,
) -> tuple[Determination, ...]:
    """Return the judgement of a mass that is held: accelerations show forces over the mass only.

    Empty where another number that is held sets the scale.
    """
    mass = run.model.parameter(MASS)
    every = (*unknowns, least_squares.Unknown(MASS, mass.unit, mass.low, mass.high, values[MASS]))
    point = np.array([values.get(unknown.name, 0.0) for unknown in every])
    partners = hidden_at(run, every, point, values, settings).get(MASS)
    if not partners:
        return ()
    return (Determination(MASS, mass.unit, TOGETHER, together_with=partners, held_at=values[MASS]),)


def hidden_at(
    run: FreeRun,
    unknowns: Sequence[least_squares.Unknown],
    point: Array,
    values: Mapping[str, float],
    settings: FitSettings,
) -> dict[str, tuple[str, ...]]:
    """Return which ``unknowns`` the law at ``point`` (u,) hides, each with those that compensate for it."""
    names = [unknown.name for unknown in unknowns]
    full = {**values, **{n: float(v) for n, v in zip(names, point, strict=True) if n in values}}
    law = EquationError(run, unknowns, run.sets(full), settings.low_cut)
    sizes = least_squares.sizes_of(unknowns, point)
    return hidden_by_name(least_squares.unseen_directions(law.force_slopes(point), sizes), names)


def to_hold(found: Sequence[Determination], model: Model, valve: Valve) -> list[Determination]:
    """Return which of the parameters without a bound to hold, at the values of ``model`` and ``valve``.

    Of those that are known only together one is enough, first one that the valve's description gives.
    """
    described = model.values_for(valve)
    lost = [one for one in found if one.lost and one.name in described]
    together = [one for one in lost if one.verdict == TOGETHER]
    given = [one for one in together if model.parameter(one.name).valve_attribute is not None]
    chosen = [*(one for one in lost if one.verdict == NOT), *(given or together)[-1:]]
    return [replace(one, held_at=described[one.name]) for one in chosen]


def check_applied(
    residuals: Residuals, unknowns: Sequence[least_squares.Unknown], point: Array, names: Collection[str]
) -> None:
    """Refuse ``unknowns`` of these ``names`` whose change changes no sample, however the valve moves.

    Args:
        residuals: of the fit.
        unknowns: all of the fit.
        point: their values, shape (u,).
        names: of those that are looked at.

    Raises:
        UnusedParameterError: the model's law does not use such a parameter.
    """
    run = residuals.run.fewer(0.0)
    low, high = least_squares.bounds_of(unknowns)
    scales = np.array([unknown.scale for unknown in unknowns])
    for place, unknown in enumerate(unknowns):
        if unknown.name not in names:
            continue
        # Others may have to act first (a frequency shows where its force has an amplitude), or may hold the
        # valve (a spring shows where friction lets it move).
        sets = np.array(
            [
                np.where(np.arange(point.size) == place, value, np.clip(others, low, high))
                for others in (point, point + 0.5 * scales, scales, 0.01 * scales)
                for value in (unknown.low, unknown.low + unknown.scale, point[place])
            ]
        )
        if not any(_shows(residuals, run, unknowns, sets, factor) for factor in EXCITATIONS):
            raise UnusedParameterError(
                f"{unknown.name}: a change of it changes no sample, however the valve moves: the law of "
                f"model '{run.model.name}' does not use it; correct the law, or remove the parameter"
            )


def _shows(
    residuals: Residuals, run: FreeRun, unknowns: Sequence[least_squares.Unknown], sets: Array, factor: float
) -> bool:
    """Return whether three ``sets`` (3 n, u) in turn move differently; ``factor``: on the excitation."""
    windows = [
        replace(one, excitation=factor * one.excitation, state=(factor * one.state[0], factor * one.state[1]))
        for one in run.windows
    ]
    driven = Residuals(run.driven_by(windows), unknowns, residuals.values, residuals.band)
    parts = np.split(driven.respond(sets)[0].acceleration, len(sets) // 3)
    return any(not np.array_equal(part, part[[0] * len(part)], equal_nan=True) for part in parts)


def by_profile(
    residuals: Weighted, point: Array, first: Determination, spread: float, dispersion: float
) -> Determination:
    """Return the judgement of a weak number by its profile likelihood.

    Args:
        residuals: weighed by their spectrum.
        point: where the descent ended, shape (u,).
        first: the judgement by the information.
        spread: standard deviation of the number, infinite or NaN where the residual has no slope.
        dispersion: variance of the point over what the information gives, 1 at least.
    """
    place = [one.name for one in residuals.unknowns].index(first.name)
    unknown = residuals.unknowns[place]
    step = unknown.size(float(point[place]))
    if math.isfinite(spread) and spread > 0.0:
        step = min(step, spread)
    profile = _Profile(residuals, point, place, dispersion)
    rows = sorted([*profile.side(-step), (float(point[place]), 0.0), *profile.side(step)])
    values, rises = zip(*rows, strict=True)
    low, high = (crossing(values, rises, float(point[place]), side) for side in (-1, 1))
    partners = tuple(one.name for one in residuals.unknowns if one.name in profile.partners)
    judged = judgement(unknown, low, high, (partners or first.together_with) if profile.noticed else ())
    unfinished = residuals.work.cut or (profile.failed and judged.verdict == NOT)
    return Determination(first.name, first.unit, UNDECIDED) if unfinished else judged


class _Profile:
    """Profile likelihood of the unknown at ``place`` of a fit that ended at ``point``.

    Attributes:
        partners: names of unknowns that compensated for a change that would have been noticed.
        noticed: such a change was tried.
        failed: the motion could not be followed at a value.
    """

    def __init__(self, residuals: Weighted, point: Array, place: int, dispersion: float) -> None:
        self.partners: set[str] = set()
        self.noticed = self.failed = False
        self._residuals, self._point, self._place = residuals, point, place
        self._dispersion = dispersion
        self._cost = float(residuals.costs(residuals.residuals(point[np.newaxis]))[0])
        self._others = [other for other in range(point.size) if other != place]

    def side(self, step: float) -> list[tuple[float, float]]:
        """Return values and rises on one side, in ``step`` (signed) until it is decided."""
        unknown = self._residuals.unknowns[self._place]
        inside, below = self._point.copy(), 0.0
        rows: list[tuple[float, float]] = []
        for factor in STEPS:
            held = inside.copy()
            held[self._place] = np.clip(self._point[self._place] + factor * step, unknown.low, unknown.high)
            if held[self._place] == inside[self._place]:
                break
            if self._residuals.work.spent >= self._residuals.work.until:
                self._residuals.work.cut = True
                break
            rise = above = self._rise_at(held, rows)
            # Where the rise is not nearly a parabola: between here and the last value that is possible.
            for _ in range(HALVINGS):
                if not above >= RISE_95 or self._nearly_parabola(inside, below, held, above):
                    break
                middle = inside.copy()
                middle[self._place] = 0.5 * (inside[self._place] + held[self._place])
                found = self._rise_at(middle, rows)
                if math.isnan(found):
                    break
                if found < RISE_95:
                    inside, below = middle, found
                else:
                    held, above = middle, found
            if not rise < RISE_95:
                break
            inside, below = held, rise
        return rows

    def _nearly_parabola(self, inside: Array, below: float, held: Array, above: float) -> bool:
        """Return whether a parabola gives the end of the interval from ``inside`` to ``held``."""
        near, far = (float(one[self._place] - self._point[self._place]) for one in (inside, held))
        return above <= NEAR * RISE_95 and NEAR * below >= above * (near / far) ** 2

    def _rise_at(self, held: Array, rows: list[tuple[float, float]]) -> float:
        """Return the rise at ``held``, whose other numbers become the fitted ones, and add it to ``rows``.

        NaN where the motion cannot be followed there.
        """
        rise = self._rise(held)
        if rise == FAILED:
            self.failed = True
            return math.nan
        if rise >= RISE_95:
            self.noticed = True
            free = copy.copy(self._residuals)
            unknowns = self._residuals.unknowns
            free.unknowns = tuple(unknowns[other] for other in self._others)
            free.values = {**free.values, unknowns[self._place].name: float(held[self._place])}
            try:
                fitted = free.descend(held[self._others][np.newaxis], ROUNDS, ENOUGH)
            except np.linalg.LinAlgError:
                return math.nan
            held[self._others] = fitted.point
            rise = max(0.0, fitted.cost - self._cost) / self._dispersion
            if rise < RISE_95:
                self.partners |= self._moved(held)
        rows.append((float(held[self._place]), rise))
        return rise

    def _moved(self, held: Array) -> set[str]:
        """Return the names of others that had to follow to ``held``: one left behind is noticed."""
        found = set()
        for other in self._others:
            behind = held.copy()
            behind[other] = self._point[other]
            if self._rise(behind) >= RISE_95:
                found.add(self._residuals.unknowns[other].name)
        return found

    def _rise(self, point: Array) -> float:
        rise = float(self._residuals.costs(self._residuals.residuals(point[np.newaxis]))[0]) - self._cost
        return max(0.0, rise) / self._dispersion if math.isfinite(rise) else FAILED
