"""Offline fit of any model to records: parameters with standard deviations that hold.

1. Start: the balance of forces at the measured motion (:mod:`.equation_error`).
2. Descent: least squares of the free run over windows (:mod:`.free_run`, :mod:`.residuals`), first with equal
   weights, then weighed by the spectrum of what is left, samples at friction's jumps left out.
3. Standard deviations: the sandwich form over blocks of the weighted residual, so that they hold for noise of
   any colour and strength that changes along the record; rank of the information matrix
   (:mod:`.observability`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from spool_sim.model import Model
from spool_sim.terms import Parameter
from spool_sim.valve import Valve
from spool_stream.errors import InputError
from spool_stream.quantity import Quantity, Validity

from .agreement import free_run_agreement
from .equation_error import EquationError
from .fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit, FitSettings
from .free_run import FreeRun
from .observability import Combination, combinations, to_hold, unseen_directions
from .record import Record
from .residuals import Residuals, Unknown

Array = NDArray[np.float64]

#: s of the blocks over which the weighted residual's slopes are summed for the standard deviations.
BLOCK = 0.5
#: Rounds with new weights after the first descent.
ROUNDS = 2
#: Sizes of what friction at rest may be, relative to its start value, that are tried.
BLIND_FACTORS = (0.1, 0.3, 1.0, 3.0)
#: Relative standard deviation from which a quantity that cannot be 0 (a velocity, a length) is not told.
UNTOLD = 0.5
#: What the valve's description gives and yet is fitted.
FITTED_OF_VALVE = ("spring_stiffness", "viscous_coefficient")


@dataclass(frozen=True, slots=True)
class _Descent:
    point: Array
    cost: float
    converged: bool


def unknowns_of(model: Model, valve: Valve, settings: FitSettings) -> tuple[Unknown, ...]:
    """Return what a fit of ``model`` finds, the sensor's nuisances last.

    Raises:
        InputError: the settings name a parameter that the model does not have.
    """
    for name in (*settings.held, *settings.free, *settings.start):
        model.parameter(name, "fit")
    found = []
    for parameter in model.parameters:
        given = parameter.valve_attribute is not None and parameter.name not in FITTED_OF_VALVE
        if parameter.name in settings.held or (given and parameter.name not in settings.free):
            continue
        found.append(
            Unknown(parameter.name, parameter.unit, parameter.low, parameter.high, _scale(parameter, valve))
        )
    if settings.fit_gain:
        found.append(Unknown(SPOOL_GAIN, "1", -0.5, 1.0, 0.05))
    if settings.fit_delay:
        found.append(Unknown(SPOOL_DELAY, "s", -5e-3, 5e-3, 1e-4))
    return tuple(found)


def _scale(parameter: Parameter, valve: Valve) -> float:
    start = abs(parameter.start_for(valve))
    if start > 0.0:
        return start
    width = parameter.high - parameter.low
    return min(1.0, width)


def fit(records: Sequence[Record], model: Model, valve: Valve, settings: FitSettings | None = None) -> Fit:
    """Return ``model`` fitted to ``records``; bad data make a result with a reason, never an error.

    Args:
        records: stretches without gaps, of one valve.
        model: any composition of force terms.
        valve: gives the mass, which is held, and start values.
        settings: what is free, the band, the windows.

    Raises:
        InputError: the settings name parameters that the model does not have, or values out of their range.
    """
    chosen = settings or FitSettings()
    unknowns = unknowns_of(model, valve, chosen)
    values = model.values_for(valve, {**chosen.start, **chosen.held})
    held = {name: value for name, value in values.items() if name not in {u.name for u in unknowns}}
    failed = Fit(model, valve.id, held=held)
    try:
        return _fit(records, model, valve, chosen, unknowns, values, held)
    except InputError as error:
        return replace(failed, reason=str(error))
    except (np.linalg.LinAlgError, FloatingPointError, OverflowError, ValueError) as error:
        return replace(failed, reason=f"the numbers broke down: {error}")


def _fit(
    records: Sequence[Record],
    model: Model,
    valve: Valve,
    settings: FitSettings,
    unknowns: tuple[Unknown, ...],
    values: Mapping[str, float],
    held: Mapping[str, float],
) -> Fit:
    run = FreeRun(
        records,
        model,
        valve,
        window=settings.window,
        run_in=settings.run_in,
        low_cut=settings.low_cut,
        longest=settings.longest,
        compensate_oil=settings.compensate_oil,
    )
    if not any(np.any(window.measured) for window in run.windows):
        raise InputError(f"{records[0].name}: the spool's acceleration is 0 throughout; check the sensor")
    points = _starts(run, unknowns, values, settings)
    band = (settings.low_cut, settings.high_cut)
    named = {unknown.name: float(value) for unknown, value in zip(unknowns, points[0], strict=True)}
    full = {**values, **{name: value for name, value in named.items() if name in values}}
    run.choose_substeps(full)
    everything = Residuals(run, unknowns, values, band)
    place = _inside(points[0], unknowns)
    unseen = unseen_directions(everything.central_slopes(place), _scales(unknowns, place))
    gauge = to_hold(unseen, [unknown.name for unknown in unknowns])
    free = tuple(unknown for unknown in unknowns if unknown.name not in gauge)
    columns = [number for number, unknown in enumerate(unknowns) if unknown.name not in gauge]
    fixed = {name: float(place[number]) for number, name in enumerate(named) if name in gauge}
    residuals = Residuals(run, free, {**full, **fixed}, band)
    descents = [_descend(residuals, _inside(point[columns], free), 12) for point in points]
    best = min(descents, key=lambda descent: descent.cost)
    residuals.choose_sampling(residuals.respond(best.point[np.newaxis]))
    for _ in range(ROUNDS):
        _reweigh(residuals, best.point)
        best = _descend(residuals, best.point, 10)
    return _result(run, residuals, best, unknowns, {**values, **fixed}, held, valve, settings)


def _starts(
    run: FreeRun, unknowns: Sequence[Unknown], values: Mapping[str, float], settings: FitSettings
) -> list[Array]:
    """Return the best points to start from, judged by the free run."""
    balance = EquationError(run, unknowns, run.sets(values), settings.low_cut)
    points = balance.starts()
    blind = [n for n, unknown in enumerate(unknowns) if unknown.name in balance.blind]
    given = np.array([values.get(unknown.name, 0.0) for unknown in unknowns])
    named = [n for n, unknown in enumerate(unknowns) if unknown.name in settings.start]
    for point in points:
        point[named] = given[named]
        point[blind] = given[blind]
    if blind:
        points = [
            np.where(np.isin(np.arange(point.size), blind[:1]), point * factor, point)
            for point in points
            for factor in BLIND_FACTORS
        ]
    points = [_inside(point, unknowns) for point in points]
    if len(points) == 1:
        return points
    named_best = {u.name: float(v) for u, v in zip(unknowns, points[0], strict=True) if u.name in values}
    run.choose_substeps({**values, **named_best})
    trial = Residuals(run, unknowns, values, (settings.low_cut, settings.high_cut))
    runs = trial.weighted(trial.differences(trial.respond(np.array(points))))
    order = np.argsort(np.nan_to_num(np.sum(runs**2, axis=1), nan=np.inf))
    return [points[number] for number in order[: max(1, settings.starts)].tolist()]


def _inside(point: Array, unknowns: Sequence[Unknown]) -> Array:
    """Return ``point`` a little inside of the bounds, where slopes to both sides exist."""
    low = np.array([unknown.low for unknown in unknowns])
    high = np.array([unknown.high for unknown in unknowns])
    room = np.minimum(1e-3 * np.array([unknown.scale for unknown in unknowns]), 0.1 * (high - low))
    return np.asarray(np.clip(point, low + room, high - room))


def _scales(unknowns: Sequence[Unknown], point: Array) -> Array:
    return np.maximum(np.abs(point), 0.1 * np.array([unknown.scale for unknown in unknowns]))


def _descend(residuals: Residuals, start: Array, steps: int) -> _Descent:
    unknowns = residuals.unknowns
    found = least_squares(
        residuals.at,
        start,
        jac=residuals.slopes,
        bounds=([unknown.low for unknown in unknowns], [unknown.high for unknown in unknowns]),
        x_scale=_scales(unknowns, start),
        xtol=1e-6,
        ftol=1e-7,
        gtol=1e-12,
        max_nfev=steps,
    )
    return _Descent(np.asarray(found.x), float(found.cost), found.status > 0)


def _reweigh(residuals: Residuals, point: Array) -> None:
    responses = residuals.respond(point[np.newaxis])
    residuals.leave_jumps_out(responses)
    residuals.take_spectrum(residuals.differences(responses))


def covariance_of(slopes: Array, residual: Array, blocks: Sequence[slice]) -> Array:
    """Return the sandwich covariance of a least-squares point, shape (u, u).

    Args:
        slopes: Jacobian, shape (n, u), of full rank.
        residual: at the point, shape (n,).
        blocks: pieces of the samples that hardly depend on each other.
    """
    bread = np.linalg.inv(slopes.T @ slopes)
    scores = np.array([slopes[block].T @ residual[block] for block in blocks])
    scores -= scores.mean(axis=0)
    count = len(blocks)
    spread = scores.T @ scores * count / max(1, count - slopes.shape[1])
    return np.asarray(bread @ spread @ bread)


def _blocks(run: FreeRun, total: int) -> list[slice]:
    blocks: list[slice] = []
    offset = 0
    sizes = [window.measured.size for window in run.windows]
    for window, size in zip(run.windows, _padded(sizes), strict=True):
        length = max(8, round(BLOCK / run.records[window.record].sample_period))
        count = max(1, window.measured.size // length)
        edges = offset + size * np.arange(count + 1) // count
        blocks += [
            slice(low, high) for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        offset += size
    assert offset == total
    return blocks


def _padded(sizes: Sequence[int]) -> list[int]:
    from scipy import fft  # noqa: PLC0415

    return [int(fft.next_fast_len(size, real=True)) for size in sizes]


def _result(
    run: FreeRun,
    residuals: Residuals,
    best: _Descent,
    unknowns: Sequence[Unknown],
    values: Mapping[str, float],
    held: Mapping[str, float],
    valve: Valve,
    settings: FitSettings,
) -> Fit:
    free = residuals.unknowns
    residual = residuals.at(best.point)
    slopes = residuals.central_slopes(best.point)
    covariance = covariance_of(slopes, residual, _blocks(run, residual.size))
    named = {unknown.name: float(value) for unknown, value in zip(free, best.point, strict=True)}
    final = {**values, **{name: value for name, value in named.items() if name in values}}
    sensor = {name: named[name] for name in (SPOOL_GAIN, SPOOL_DELAY) if name in named}
    everything = Residuals(run, unknowns, final, residuals.band)
    everything.band_limited = residuals.band_limited
    everything.kept, everything.spectrum = residuals.kept, residuals.spectrum
    point = np.array([{**final, **sensor}[unknown.name] for unknown in unknowns])
    scales = _scales(unknowns, point)
    unseen = unseen_directions(everything.central_slopes(point), scales)
    names = [unknown.name for unknown in unknowns]
    lost, told = combinations(unseen, names, [u.unit for u in unknowns], {**final, **sensor}, scales)
    deviations = dict(zip(named, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    places = [names.index(unknown.name) for unknown in free]
    parameters = []
    unclear = list(lost)
    for unknown in unknowns:
        deviation = deviations.get(unknown.name, math.nan)
        untold = unknown.low > 0.0 and not deviation < UNTOLD * abs(named.get(unknown.name, 0.0))
        if unknown.name in lost or untold:
            parameters.append(Quantity(unknown.name, unknown.unit))
            unclear += [unknown.name] if unknown.name not in unclear else []
        else:
            parameters.append(
                Quantity(unknown.name, unknown.unit, named[unknown.name], deviation, Validity.VALID)
            )
    observable = [n for n, unknown in enumerate(free) if unknown.name not in unclear]
    spread = np.sqrt(np.diag(covariance))[observable]
    at_bound = tuple(
        unknown.name
        for unknown, value in zip(free, best.point.tolist(), strict=True)
        if min(value - unknown.low, unknown.high - value) <= 1e-6 * unknown.scale
    )
    return Fit(
        model=run.model,
        valve=valve.id,
        converged=best.converged,
        parameters=tuple(parameters),
        not_observable=tuple(unclear),
        combinations=tuple(_told(entry, covariance, places) for entry in told),
        held=held,
        values=final,
        sensor=sensor,
        correlation=covariance[np.ix_(observable, observable)] / np.outer(spread, spread),
        observable=tuple(free[n].name for n in observable),
        at_bound=at_bound,
        agreement=free_run_agreement(
            run.records, run.model, valve, final, sensor=sensor, run_in=settings.run_in,
            low_cut=settings.low_cut, compensate_oil=settings.compensate_oil,
        ),
    )  # fmt: skip


def _told(combination: Combination, covariance: Array, places: Sequence[int]) -> Quantity:
    gradient = combination.gradient[list(places)]
    deviation = math.sqrt(max(0.0, float(gradient @ covariance @ gradient)))
    return Quantity(combination.name, combination.unit, combination.value, deviation, Validity.VALID)
