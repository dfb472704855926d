"""Observation of a fleet: what the tables would hold of each bag.

A fleet's year has five thousand bags, too many to simulate for many fleets. The errors of the estimator are
those of bags that were simulated, drawn at random: they are small beside what the world does from bag to bag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from spool_estimator.estimate import Estimate, State
from spool_estimator.estimator import make_estimator, settings_for
from spool_fleet.analyses.base import REFERENCE
from spool_fleet.trends.observations import (
    COULOMB,
    PARAMETERS,
    STIFFNESS,
    UNCERTAIN,
    VISCOUS,
    ObservedValve,
    Series,
)

from .world import (
    BAGS,
    MACHINES,
    SECONDS,
    VALVES_EACH,
    WEEKS,
    BagTruth,
    World,
    bag_truth,
    described_valve,
    draw_world,
    simulated_bag,
)

UNITS = {VISCOUS: "N s/m", COULOMB: "N", STIFFNESS: "N/m"}


@dataclass(frozen=True, slots=True)
class EstimationError:
    """Errors of one bag's estimates by parameter, and the deviations that were stated; both relative."""

    error: dict[str, float]
    deviation: dict[str, float]


def simulated_error(seed: int) -> EstimationError | None:
    """Return the errors of a bag drawn from ``seed``, simulated and estimated; ``None``: not tracked."""
    generator = np.random.default_rng([seed, 22])
    world = draw_world(seed)
    number = int(generator.integers(MACHINES * VALVES_EACH))
    truth, simulator = simulated_bag(world, number, int(generator.integers(WEEKS * BAGS)))
    estimator = make_estimator("prediction", settings_for(described_valve()))
    estimates: list[Estimate] = []
    for block in simulator.records(SECONDS):
        estimates += estimator.update(block)
    latest = estimates[-1] if estimates else None
    if latest is None or latest.state is not State.TRACKING:
        return None
    errors, deviations = {}, {}
    true = _parameters(truth)
    for quantity in latest.parameters:
        if not quantity.value > 0.0 or quantity.standard_deviation > UNCERTAIN * quantity.value:
            return None
        errors[quantity.name] = quantity.value / true[quantity.name] - 1.0
        deviations[quantity.name] = quantity.standard_deviation / quantity.value
    return EstimationError(errors, deviations)


def observe(world: World, errors: Sequence[EstimationError | None]) -> list[ObservedValve]:
    """Return what the tables would hold of ``world``, with estimation errors drawn from ``errors``."""
    return [_valve(world, number, errors) for number in range(len(world.valves))]


def _parameters(truth: BagTruth) -> dict[str, float]:
    return {VISCOUS: truth.drag, COULOMB: truth.rubbing, STIFFNESS: truth.stiffness}


def _valve(world: World, number: int, errors: Sequence[EstimationError | None]) -> ObservedValve:
    rows: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in PARAMETERS}
    generator = np.random.default_rng([world.seed, 23, number])
    sheet = described_valve()
    for place in range(WEEKS * BAGS):
        truth = bag_truth(world, number, place)
        error = errors[int(generator.integers(len(errors)))]
        if error is None:
            continue
        for name, true in _parameters(truth).items():
            value = true * (1.0 + error.error[name])
            if name == VISCOUS:
                value *= sheet.dynamic_viscosity_at(REFERENCE) / sheet.dynamic_viscosity_at(truth.measured)
            rows[name].append((truth.day, math.log(value), error.deviation[name], truth.measured))
    valve = world.valves[number]
    series = {}
    for name, own in rows.items():
        if own:
            day, logarithm, deviation, celsius = np.array(own).T
            series[name] = Series(day, logarithm, deviation, celsius, UNITS[name], name == VISCOUS)
    return ObservedValve(f"machine_{valve.machine + 1}", f"valve_{valve.number + 1}", series)
