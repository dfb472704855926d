"""Position of a driven mass: free runs from its force alone, and numbers that follow the position best.

The balance of forces needs accelerations, whose smoothing and noise bias its numbers; a free run sees forces
that are a thousandth of the measured one, since they add up. Fits run over stretches that start from the
measured motion (multiple shooting), so that errors do not add up over a whole record. A term that helps on
what it was fitted to and not on the other parts of the training records is refused (cross-validation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.optimize import least_squares
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_gap.catalogue import EFFECTS
from spool_gap.effect import Effect
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, substeps_for
from spool_sim.model import Model
from spool_sim.terms import term

from spool_rigs.balance import BASE_NAMES, ForceBalance, ForceFit, correlation_of, independent_samples
from spool_rigs.records import ForceRecord, white_power

Chosen = tuple[tuple[Effect, dict[str, float]], ...]

#: Effect that is the zero of a driven record's force: it is in the base of every fit already.
CONSTANT = "constant_force"
#: Error of the velocity that a run starts with, over the velocity's rms: what it adds to the displacement is
#: that share of a time constant's way.
SPEED_ERROR = 2e-3
#: Steps a sample at least: the force between samples is taken as linear.
FEWEST_STEPS = 2
#: s of a stretch: friction and drag act on the position within one, and a constant force too.
STRETCH = 8.0
#: Samples of the position that are compared in each stretch: it changes no faster.
COMPARED = 400
#: Relative step of the differences: that of the regression's rounding over a free run of some 10,000 steps.
STEP = 1e-4
#: Runs of the descent at most: it takes some 30 where it converges.
MOST_RUNS = 200
#: s of a part at least: friction and drag act on the position within one, slow forces within a few.
PART = 6.0
#: Parts at most, each of which is left out once: with fewer than three nothing is left to fit.
MOST_PARTS, FEWEST_PARTS = 4, 3


def fitted_by_position(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> ForceFit | None:
    """Return ``fit`` with the coefficients that follow the position best; ``None`` where no run succeeds.

    Args:
        base: model that ``chosen`` effects, with their shapes, are added to.
        balance: gives the training records.
        chosen: effects.
        fit: by the balance of forces, where the descent starts.
    """
    parts, speeds = stretches_of(balance.train)
    size = np.maximum(np.abs(fit.coefficients), fit.deviations)
    # What no sample of the balance shows, as with a part that sticks, has neither; the free run may show it.
    size[size == 0.0] = 1.0
    scale = max(1e-12, float(np.std(np.concatenate([part.displacement for part in parts]))))

    def errors(numbers: Array) -> Array:
        moved = replace(fit, coefficients=numbers * size)
        rows = []
        for part, speed in zip(parts, speeds, strict=True):
            every = max(1, part.force.size // COMPARED)
            try:
                model, zero = model_with(base, balance, chosen, moved)
                start = float(part.displacement[0]) - balance.centre, speed
                run = position_run(part, start, model, zero, balance.sign)
            except InputError:
                run = np.full(part.force.size, np.inf)
            error = (run - part.displacement)[::every] / scale
            rows.append(np.clip(np.nan_to_num(error, nan=1e3, posinf=1e3), -1e3, 1e3))
        return np.concatenate(rows)

    start = fit.coefficients / size
    found = least_squares(errors, start, diff_step=STEP, max_nfev=MOST_RUNS)
    if not np.isfinite(found.cost) or found.cost >= 0.5 * float(np.sum(errors(start) ** 2)):
        return None
    slopes = found.jac / _deviation(found.fun, len(parts))
    covariance = np.asarray(np.linalg.pinv(slopes.T @ slopes))
    moved = replace(
        fit,
        coefficients=found.x * size,
        deviations=np.sqrt(np.maximum(np.diag(covariance), 0.0)) * size,
        correlation=correlation_of(covariance),
    )
    return balance.measured(moved, chosen)


def cross_validated(
    records: Sequence[ForceRecord],
    columns: Sequence[str],
    chosen: Chosen,
    base: Model,
    mass: float | None,
    *,
    by_position: bool = True,
) -> float:
    """Return the error of free runs of position over each part by a fit of the others, m; infinite for none.

    Args:
        records: of the training.
        columns: of the base's balance.
        chosen: effects with their shapes.
        base: model that they are added to.
        mass: kg, ``None`` where it is fitted.
        by_position: the fits follow the position, else the balance of forces alone.
    """
    parts = parts_of(records)
    if len(parts) < FEWEST_PARTS:
        return math.inf
    squares = []
    for number, part in enumerate(parts):
        others = [other for place, other in enumerate(parts) if place != number]
        balance = ForceBalance(others, [part], columns, driven=True, mass=mass)
        fit = balance.fit(chosen)
        if by_position:
            fit = fitted_by_position(base, balance, chosen, fit) or fit
        squares.append(free_run_error(base, balance, chosen, fit) ** 2)
    error = math.sqrt(float(np.mean(squares)))
    return error if math.isfinite(error) else math.inf


def free_run_error(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> float:
    """Return the error of the free run of position over the held-out records, m; NaN for imposed motion."""
    if not balance.driven:
        return math.nan
    try:
        model, zero = model_with(base, balance, chosen, fit)
    except InputError:
        return math.nan
    return position_rmse(balance.held, model, zero, balance.centre, balance.sign)


def model_with(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> tuple[Model, float]:
    """Return ``base`` with ``chosen`` effects by the numbers of ``fit``, and the force's zero apart, N.

    Raises:
        InputError: no mass can be moved by these numbers.
    """
    numbers = fit.coefficients
    mass = balance.mass or (float(numbers[balance.base.index("mass")]) if "mass" in balance.base else 0.0)
    if not np.isfinite(numbers).all() or mass <= 0.0:
        raise InputError("mass: a free run needs a mass > 0 kg")
    for entry, shape in chosen:
        if entry.id != CONSTANT and balance.values(entry, shape, fit) is None:
            raise InputError(f"{entry.id}: its fitted parameters are physically impossible")
    model = model_of(base, balance, tuple(pair for pair in chosen if pair[0].id != CONSTANT), fit)
    if "inertia" not in {entry.name for entry in model.terms}:
        raise InputError(f"{base.name}: a free run needs the term inertia")
    return model, float(numbers[balance.base.index("zero")]) if "zero" in balance.base else 0.0


def model_of(base: Model, balance: ForceBalance, chosen: Chosen, fit: ForceFit) -> Model:
    """Return ``base`` with ``chosen`` effects as terms, with the numbers of ``fit``."""
    # Parameters that an effect does not fit keep the start value of their term.
    values = {p.name: p.start for entry, _ in chosen for name in entry.terms for p in term(name).parameters}
    values |= {
        BASE_NAMES[name][0]: float(fit.coefficients[n])
        for n, name in enumerate(balance.base)
        if name != "zero"
    }
    gone = {"spring"} if "stiffness" not in balance.base else set()
    gone |= {"viscous_friction"} if "damping" not in balance.base else set()
    terms = [entry for entry in base.terms if entry.name not in gone]
    terms += [term(name) for entry, _ in chosen for name in entry.terms]
    for entry, shape in chosen:
        own = [] if entry.id != CONSTANT else parameters_of(balance, fit, entry, shape)
        values |= {q.name: q.value for q in own} or balance.values(entry, shape, fit) or {}
    if balance.mass is not None:
        values["mass"] = balance.mass
    known = {p.name for own in terms for p in own.parameters}
    kept = {name: value for name, value in values.items() if name in known}
    return Model("_".join([base.name, *(e.id for e, _ in chosen)]), tuple(terms), kept)


def parameters_of(
    balance: ForceBalance, fit: ForceFit, entry: Effect, shape: dict[str, float]
) -> list[Quantity]:
    """Return the numbers of the effect ``entry`` with ``shape`` in ``fit``."""
    if entry.id == CONSTANT and "zero" in balance.base:
        place = balance.base.index("zero")
        push, spread = -balance.sign * float(fit.coefficients[place]), float(fit.deviations[place])
        return [Quantity("push", "N", push, spread, Validity.VALID)]
    values = balance.values(entry, shape, fit) or {}
    own = [n for n, name in enumerate(fit.names) if name.startswith(f"{entry.id}.")]
    relative = fit.deviations[own] / np.maximum(np.abs(fit.coefficients[own]), 1e-30)
    units = {p.name: p.unit for name in entry.terms for p in term(name).parameters}
    place = fit.effects.index(entry.id)
    together = [(EFFECTS[name], held) for name, held in zip(fit.effects, fit.shapes, strict=True)]

    def deviation(name: str) -> float:
        if shape.get(name, 0.0) != 0.0 and name not in entry.scanned:
            return balance.shape_deviation(together, fit, place, name)
        found = abs(values[name]) * float(relative.min())
        for inner in shape.keys() - {*entry.fitted, *entry.scanned}:
            # A number of the law alone, as the travel of Dahl's: what it adds to those that depend on it.
            moved = balance.values(entry, {**shape, inner: 1.001 * shape[inner]}, fit) or values
            slope = (moved[name] - values[name]) / (1e-3 * shape[inner])
            if slope != 0.0:
                found = math.hypot(found, slope * balance.shape_deviation(together, fit, place, inner))
        return found

    return [
        Quantity(name, units[name], values[name], deviation(name), Validity.VALID)
        for name in entry.fitted
        if name in values
    ]


def position_run(
    record: ForceRecord, start: tuple[float, float], model: Model, zero: float, sign: float = 1.0
) -> Array:
    """Return the displacement, m, shape (n,), that ``model`` gives for the force of ``record``.

    The run starts from the measured displacement and velocity and sees the force alone from there on.

    Args:
        record: displacement and force, shape (n,).
        start: displacement from the middle of the springs, m, and velocity, m/s, at its first sample.
        model: with the mass among its values.
        zero: of the load cell, or a constant force, N, in the direction of the velocity.
        sign: -1 where the rig counts the force against the velocity.

    Raises:
        InputError: the model is too stiff for the record's rate.
    """
    values = dict(model.values)
    mass = values["mass"]
    substeps = max(FEWEST_STEPS, substeps_for(model.terms, values, record.period))
    places = np.arange(2 * record.force.size * substeps + 1) / (2.0 * substeps)
    pushed = -(sign * record.force - zero) / mass
    steps = np.interp(places, np.arange(record.force.size), pushed)
    kernel = _kernel(tuple(entry.name for entry in model.terms))
    table = kernel.table(values, record.force.size)
    place, speed = start
    state = MotionState(place, speed, float(np.sign(speed)))
    trajectory, _ = kernel.advance(state, steps, table, sample_period=record.period, substeps=substeps)
    return np.asarray(trajectory.displacement + (record.displacement[0] - place))


def speed_at(record: ForceRecord, place: int) -> float:
    """Return the velocity at the sample ``place`` of ``record``, m/s: the slope of a parabola around it.

    Over as few samples as the displacement's noise allows: from rest the motion begins within some.
    """
    rms = float(np.std(np.diff(record.displacement))) / record.period
    noise = math.sqrt(white_power(record.displacement))
    # The variance of the slope at the end of n samples of a parabola is 192 sigma^2 / (n^3 period^2).
    wanted = (192.0 * (noise / (SPEED_ERROR * max(rms, 1e-12) * record.period)) ** 2) ** (1.0 / 3.0)
    half = int(np.clip(math.ceil(0.5 * wanted), 2, max(2, record.force.size // 20)))
    low, high = max(0, place - half), min(record.force.size, place + half + 1)
    time = (np.arange(low, high) - place) * record.period
    return float(np.polyfit(time, record.displacement[low:high], 2)[1])


@lru_cache(maxsize=16)
def _kernel(names: tuple[str, ...]) -> ComposedMotion:
    """Return the kernel of the terms called ``names``, loaded once."""
    return ComposedMotion([term(name) for name in names])


def position_rmse(
    records: Sequence[ForceRecord], model: Model, zero: float, centre: float, sign: float = 1.0
) -> float:
    """Return rms(model - measured) of free runs over ``records``, m; NaN where the model cannot be run.

    ``centre`` is the middle of the springs, m.
    """
    squares = count = 0.0
    for record in records:
        start = float(record.displacement[0]) - centre, speed_at(record, 0)
        try:
            error = position_run(record, start, model, zero, sign)
        except InputError:
            return math.nan
        error = error - record.displacement
        squares += float(np.sum(error**2))
        count += error.size
    return math.sqrt(squares / count) if np.isfinite(squares) else math.nan


def stretches_of(records: Sequence[ForceRecord]) -> tuple[list[ForceRecord], list[float]]:
    """Return ``records`` cut into stretches of ``STRETCH`` s or a little more, and where each begins, m/s."""
    found: list[ForceRecord] = []
    speeds = []
    for record in records:
        first = 0
        for part in record.cut(max(1, int(record.duration / STRETCH))):
            found.append(part)
            speeds.append(speed_at(record, first))
            first += part.force.size
    return found, speeds


def _deviation(errors: Array, parts: int) -> float:
    """Return the deviation that each of ``errors`` has were they independent: drifts hold few numbers."""
    independent = max(1.0, sum(independent_samples(row) for row in np.array_split(errors, parts)))
    return max(1e-12, float(np.sqrt(np.mean(errors**2) * errors.size / independent)))


def parts_of(records: Sequence[ForceRecord]) -> list[ForceRecord]:
    """Return ``records`` cut into parts that are left out by turns; few where they are short."""
    return [
        part for record in records for part in record.cut(int(np.clip(record.duration / PART, 1, MOST_PARTS)))
    ]
