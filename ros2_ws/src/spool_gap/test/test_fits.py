"""Fits of the gap search: windows together move as each alone, and what came to rest is not fitted again."""

from __future__ import annotations

import numpy as np
import pytest
from spool_estimator.identification.record import records_from_blocks
from spool_gap.fitting.hypothesis import Fitting
from spool_gap.result import GapSettings
from spool_gap.simulation.batches import steps_a_sample
from spool_gap.simulation.point import Point
from spool_gap.simulation.segments import stretches_of
from spool_gap.simulation.shooting import pieces_of
from spool_gap.simulation.simulate import Simulation
from spool_gap.simulation.switchable import SwitchableMotion
from spool_gap.workflow.preparation import motions_for
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState
from spool_sim.integration.step_size import half_step_times
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.sensors import Sensor
from spool_sim.simulator import Simulator
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
FLUID = MODELS["fluid"]
BASE = tuple(entry.name for entry in FLUID.terms)
EXTRAS = ("coulomb_friction", "stribeck_friction", "presliding_friction", "end_stop", "spring_backlash")
COULOMB = (*BASE, "coulomb_friction")
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=8.0, amplitude=8.0)


@pytest.fixture(scope="module", name="fitting")
def _fitting() -> Fitting:
    """Pieces of a record with dry friction."""
    sensor = Sensor(noise=0.02)
    simulator = Simulator(
        VALVE, SWEEP, model="coulomb", parameters={"coulomb_force": 0.3}, sample_rate=1000.0, block_size=50,
        body_sensor=sensor, spool_sensor=sensor,
    )  # fmt: skip
    (record,) = records_from_blocks(simulator.records(10.0), "dry")
    stretches = stretches_of([record], [], FLUID, VALVE, damping=2.0)
    pieces = pieces_of(stretches, 9000)
    return Fitting(Simulation(pieces, motions_for(FLUID)), FLUID, VALVE, GapSettings())


def points() -> list[Point]:
    values = {**FLUID.values_for(VALVE), "coulomb_force": 0.25}
    start = Point(COULOMB, values)
    return [start, start.moved(("coulomb_force", "spool_delay"), (0.35, 1e-4))]


def test_all_windows_in_one_call_move_as_each_alone(fitting: Fitting) -> None:
    simulation = fitting.simulation
    chosen = list(range(len(simulation.places)))
    together = simulation.run(points(), chosen)
    for place in chosen:
        alone = simulation.run(points(), [place])[0]
        for name in ("acceleration", "means", "displacement", "velocity"):
            np.testing.assert_array_equal(getattr(together[place], name), getattr(alone, name))
    assert not np.array_equal(together[0].means[0], together[0].means[1])


@pytest.mark.parametrize("extra", EXTRAS)
def test_a_kernel_of_all_terms_moves_as_one_of_the_terms_that_are_on(extra: str) -> None:
    active = (*BASE, extra)
    every = SwitchableMotion((*BASE, *EXTRAS))
    model = model_from_mapping({"name": "own", "terms": list(active)}, "own")
    own = ComposedMotion([term(name) for name in active])
    values = {**model.values_for(VALVE), "stop_gap": 2e-4}
    body = SWEEP.acceleration(half_step_times(0, 2000, 1000.0, 2))
    given = {"sample_period": 1e-3, "substeps": 2}
    one, _ = every.advance(MotionState(), body, every.row(active, values)[np.newaxis], **given)
    other, _ = own.advance(MotionState(), body, own.table(values, 1), **given)
    np.testing.assert_allclose(one.acceleration, other.acceleration, rtol=1e-9, atol=1e-9)
    assert np.ptp(one.displacement) > 1e-4


def test_a_base_without_drag_has_none_in_the_kernel_that_holds_it() -> None:
    active = ("inertia", "spring")
    every = SwitchableMotion(BASE)
    own = ComposedMotion([term(name) for name in active])
    values = {"mass": 0.18, "spring_stiffness": 1632.0, "viscous_coefficient": 4.0}
    body = SWEEP.acceleration(half_step_times(0, 2000, 1000.0, 2))
    given = {"sample_period": 1e-3, "substeps": 2}
    one, _ = every.advance(MotionState(), body, every.row(active, values)[np.newaxis], **given)
    other, _ = own.advance(MotionState(), body, own.table(values, 1), **given)
    np.testing.assert_allclose(one.acceleration, other.acceleration, rtol=1e-9, atol=1e-9)


def test_a_fit_that_came_to_rest_is_fitted_again_only_after_the_weight_changed(fitting: Fitting) -> None:
    step = fitting.fit(("coulomb_friction",), points()[:1], rounds=30)
    assert step.fitted.point.get("coulomb_force") == pytest.approx(0.3, rel=0.03)
    assert fitting.polished(step) is step
    weighed = fitting.weighed_by(step)
    again = weighed.polished(step, rounds=30)
    assert again is not step
    assert weighed.polished(again) is again
    assert fitting.polished(step) is step, "another weight leaves the first problem as it is"


def test_steps_grow_shorter_with_stiffness_and_where_a_force_has_kinks() -> None:
    start, _ = points()
    stiff = Point((*BASE, "presliding_friction"), {**start.values, "dahl_force": 0.3, "dahl_stiffness": 1e6})
    stop = Point((*BASE, "end_stop"), {**start.values, "stop_stiffness": 1e3})
    smooth, kinked = (steps_a_sample(point, 1e-3, 100.0) for point in (start, stop))
    assert smooth < kinked
    assert smooth < steps_a_sample(stiff, 1e-3, 100.0) <= 8
