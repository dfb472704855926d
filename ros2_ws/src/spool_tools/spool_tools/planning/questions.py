"""Questions to a planned record, and their answers: what the shipped fit would know from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from spool_core.errors import InputError
from spool_core.quantity import Quantity
from spool_core.uncertainty import Z_95, percent
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import Fit, FitSettings
from spool_sim.model import Model, load_model

from .planned import Plan, travel

#: Standard deviations of a size that is told from 0: noise alone gives as much in one of 370 records (normal
#: distribution), and half of the records with that size give more.
TOLD = 3.0
#: Share of the force of inertia that the search for the smallest size begins at; factor of its steps, how
#: many there are at most on the way to a size that is told and one that is not, and halvings: to 1.3.
BEGIN, STRIDE, STEPS, HALVINGS = 0.02, 8.0, 4, 3
#: What an end stop is described by.
STOP = ("stop_gap", "stop_stiffness", "stop_dissipation")
#: Share of the travel at which a stop is put, to see how well its place is told.
STOP_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class Limit:
    """Limit of what a record tells: the least ``value`` of a quantity, and what that means."""

    quantity: str
    value: float
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer to a question: parameters with standard deviations, the truth they were made with, a limit."""

    parameters: tuple[Quantity, ...] = ()
    truth: Mapping[str, float] | None = None
    limit: Limit | None = None
    reason: str | None = None
    notes: tuple[str, ...] = ()


def _fitted(
    plan: Plan, model: Model, values: Mapping[str, float], start: Mapping[str, float] | None = None
) -> tuple[Fit, dict[str, float]]:
    truth = model.values_for(plan.valve, plan.values(values))
    return fit([plan.record(model, values)], model, plan.valve, FitSettings(start=start or {})), truth


def _smallest(
    plan: Plan,
    model: Model,
    values_of: Callable[[float], dict[str, float]],
    deviation_of: Callable[[Fit], float],
) -> tuple[float | None, Fit, dict[str, float]]:
    """Return the smallest size that is ``TOLD`` of its standard deviations, the fit there and its truth.

    ``None`` where no size up to the force of inertia is told.
    """
    quiet = plan.record(load_model("fluid"), {}, noisy=False)
    largest = plan.valve.moving_mass * float(np.sqrt(np.mean(quiet.spool**2)))
    best: tuple[float | None, Fit, dict[str, float]]

    def told(size: float) -> bool:
        nonlocal best
        found, truth = _fitted(plan, model, values_of(size))
        deviation = math.nan if found.reason else deviation_of(found)
        enough = bool(deviation * TOLD <= size)
        if enough:
            best = size, found, truth
        elif best[0] is None:
            best = None, found, truth
        return enough

    best = None, Fit(model, plan.valve.id, reason="nothing was tried"), {}
    high = BEGIN * largest
    if told(high):
        low = next(
            (size for size in (high / STRIDE**step for step in range(1, STEPS + 1)) if not told(size)), 0.0
        )
        high = best[0] or high
    else:
        low = high
        high = next((size for size in (high * STRIDE, largest) if told(size)), 0.0)
        if high == 0.0:
            return best
        low = high / STRIDE
    for _ in range(HALVINGS if low > 0.0 else 0):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if told(middle) else (middle, high)
    return best


def coulomb_friction(plan: Plan) -> Answer:
    """Answer how small a dry friction the record tells from none."""

    def deviation(found: Fit) -> float:
        return found.parameter("coulomb_force").standard_deviation

    size, found, truth = _smallest(
        plan, load_model("coulomb"), lambda force: {"coulomb_force": force}, deviation
    )
    meaning = "smallest Coulomb force that is told from none (3 standard deviations)"
    return _sized(found, truth, None if size is None else Limit("coulomb_force", size, "N", meaning))


def stribeck_friction(plan: Plan) -> Answer:
    """Answer how small an excess of friction at rest over that at speed the record tells."""
    model = load_model("stribeck")
    force = model.parameter("coulomb_force").start_for(plan.valve)

    def deviation(found: Fit) -> float:
        names = ("static_force", "coulomb_force")
        if not set(names) <= set(found.observable):
            return math.nan
        rest, speed = (found.parameter(name).standard_deviation for name in names)
        place, other = (found.observable.index(name) for name in names)
        shared = float(found.correlation[place, other]) * rest * speed
        return math.sqrt(max(rest**2 + speed**2 - 2.0 * shared, 0.0))

    def values(excess: float) -> dict[str, float]:
        return {"coulomb_force": force, "static_force": force + excess}

    size, found, truth = _smallest(plan, model, values, deviation)
    meaning = (
        f"smallest excess of the force at rest over {force:g} N at speed that is told (3 standard deviations)"
    )
    return _sized(found, truth, None if size is None else Limit("static_excess", size, "N", meaning))


def mixed_friction(plan: Plan) -> Answer:
    """Answer how well the numbers of mixed lubrication are told, at those that fits start from."""
    found, truth = _fitted(plan, load_model("mixed"), {})
    return _answer(found, truth, None)


def viscous_coefficient(plan: Plan) -> Answer:
    """Answer how small a change of the drag two such records tell: wear, by the clearance."""
    answer = _change(plan, "viscous_coefficient", "drag (clearance by the same share: wear)")
    valve = plan.valve
    if not valve.oil_ratio_known:
        return replace(answer, notes=("without the oil's name and temperature, warm oil looks like wear",))
    ratio = valve.dynamic_viscosity_at(valve.oil_temperature + 1.0) / valve.dynamic_viscosity
    note = f"a kelvin of the oil changes the drag by {percent(1.0 - ratio)}: record its temperature"
    return replace(answer, notes=(note,))


def spring_stiffness(plan: Plan) -> Answer:
    """Answer how small a change of the stiffness two such records tell."""
    return _change(plan, "spring_stiffness", "stiffness")


def _change(plan: Plan, name: str, what: str) -> Answer:
    found, truth = _fitted(plan, load_model("coulomb"), {})
    if found.reason is not None:
        return _answer(found, truth, None)
    # Two records, each with its own error: the difference has sqrt(2) of it.
    least = Z_95 * math.sqrt(2.0) * found.parameter(name).standard_deviation / truth[name]
    meaning = f"smallest relative change of the {what} between two such records (95 %)"
    return _answer(found, truth, Limit(f"relative_change_of_{name}", least, "1", meaning))


def end_stop(plan: Plan) -> Answer:
    """Answer how far the spool comes, so which stops it meets, and how well the place of one is told."""
    reach = travel(plan.record(load_model("fluid"), {}, noisy=False))
    model = load_model("fluid_end_stop")
    values = {"stop_gap": STOP_SHARE * reach}
    # From the truth: the gap workflow, unlike a plain fit, tries many stops.
    start = {name: model.values_for(plan.valve, plan.values(values))[name] for name in STOP}
    found, truth = _fitted(plan, model, values, start)
    meaning = "travel of the spool: stops beyond it are not met, so this record cannot tell of them"
    return _answer(found, truth, Limit("stop_gap", reach, "m", meaning))


def _sized(found: Fit, truth: Mapping[str, float], limit: Limit | None) -> Answer:
    answer = _answer(found, truth, limit)
    untold = "no size up to the spool's force of inertia"
    return answer if limit is not None or answer.reason else replace(answer, reason=untold)


def _answer(found: Fit, truth: Mapping[str, float], limit: Limit | None) -> Answer:
    if found.reason is not None:
        return Answer(truth=truth, limit=limit, reason=found.reason)
    untold = [name for name in found.not_observable if name not in found.held]
    reason = f"{', '.join(untold)}: such a record does not tell" if limit is None and untold else None
    return Answer((*found.parameters, *found.combinations), truth, limit, reason)


QUESTIONS: Mapping[str, Callable[[Plan], Answer]] = {
    "coulomb_friction": coulomb_friction,
    "stribeck_friction": stribeck_friction,
    "mixed_friction": mixed_friction,
    "viscous_coefficient": viscous_coefficient,
    "spring_stiffness": spring_stiffness,
    "end_stop": end_stop,
}
#: Answered by the gap workflow, effect by effect: see :mod:`.effects_named`.
WHICH_EFFECT = "which_effect"


def question(name: str) -> Callable[[Plan], Answer]:
    """Return what answers the question ``name``.

    Raises:
        InputError: there is none of that name.
    """
    if name not in QUESTIONS:
        raise InputError(
            f"--question {name}: there is none of that name; there are {', '.join(QUESTIONS)}, {WHICH_EFFECT}"
        )
    return QUESTIONS[name]
