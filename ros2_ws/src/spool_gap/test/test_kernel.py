"""One kernel for every structure moves as a separate kernel, and steps as finely as a structure needs."""

from __future__ import annotations

import numpy as np
import pytest
from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood.kernel import Point, motions_for, steps_a_sample
from spool_sim.excitation import SweptSine
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, half_step_times
from spool_sim.model import MODELS, model_from_mapping
from spool_sim.observation import CAUSAL, Observation
from spool_sim.terms import term
from spool_sim.valve import find_valve

VALVE = find_valve("4weh10_soft").model_copy(update={"dynamic_viscosity": 0.03})
FLUID = MODELS["fluid"]
BASE = tuple(entry.name for entry in FLUID.terms)
EXTRAS = ("coulomb_friction", "stribeck_friction", "presliding_friction", "end_stop", "spring_backlash")
SWEEP = SweptSine(start_frequency=6.0, stop_frequency=60.0, duration=8.0, amplitude=8.0)


@pytest.mark.parametrize("extra", EXTRAS)
def test_a_kernel_of_all_terms_moves_as_one_of_the_terms_that_are_on(extra: str) -> None:
    active = (*BASE, extra)
    _, every = motions_for(FLUID)
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
    every, _ = motions_for(FLUID)
    own = ComposedMotion([term(name) for name in active])
    values = {"mass": 0.18, "spring_stiffness": 1632.0, "viscous_coefficient": 4.0}
    body = SWEEP.acceleration(half_step_times(0, 2000, 1000.0, 2))
    given = {"sample_period": 1e-3, "substeps": 2}
    one, _ = every.advance(MotionState(), body, every.row(active, values)[np.newaxis], **given)
    other, _ = own.advance(MotionState(), body, own.table(values, 1), **given)
    np.testing.assert_allclose(one.acceleration, other.acceleration, rtol=1e-9, atol=1e-9)


def test_steps_grow_shorter_with_stiffness_and_where_a_force_has_kinks() -> None:
    values = dict(FLUID.values_for(VALVE))
    start = Point((*BASE, "coulomb_friction"), {**values, "coulomb_force": 0.25})
    stiff = Point((*BASE, "presliding_friction"), {**values, "dahl_force": 0.3, "dahl_stiffness": 1e6})
    stop = Point((*BASE, "end_stop"), {**values, "stop_stiffness": 1e3})
    smooth, kinked = (steps_a_sample(point, 1e-3, 100.0) for point in (start, stop))
    assert smooth < kinked
    assert smooth < steps_a_sample(stiff, 1e-3, 100.0) <= 8


def test_how_friction_falls_after_a_reversal_is_resolved() -> None:
    """A step may not pass the speed over which it falls, however slowly all else moves."""
    active = (*BASE, "mixed_friction")
    values = dict(FLUID.values_for(VALVE)) | {"normal_load": 1.6}
    values |= {"mixed_root_coefficient": 0.46, "mixed_inverse_coefficient": 0.0015, "mixed_velocity": 0.01}
    motion = next(one for one in motions_for(FLUID) if one.has(active))
    observation, rows = Observation(CAUSAL, 6.0, 0.29), []
    for steps in (steps_a_sample(Point(active, values), 1e-3, 80.0, 20.0), 32):
        body = SWEEP.acceleration(half_step_times(0, 2000, 1000.0, steps))
        (found,) = motion.read_batch(
            MotionState(0.0, 0.0, 0.0), body[np.newaxis], motion.row(active, values)[np.newaxis, np.newaxis],
            rows=np.zeros(1, dtype=np.int64), sample_period=1e-3, substeps=steps,
        )  # fmt: skip
        rows.append(observation.read(found.acceleration, found.events, steps))
    assert float(np.std(rows[0] - rows[1])) < 3e-4 * float(np.std(rows[1]))


#: Values at which an effect moves the valve well within the sweep; what is not named starts as declared.
SIZES = {
    "stop_gap": 1e-3, "stop_stiffness": 2e4, "backlash": 2e-4, "preload_force": 0.5, "preload_travel": 1e-4,
    "cubic_coefficient": 1e8,
}  # fmt: skip


@pytest.mark.parametrize(
    "extra",
    dict.fromkeys(name for one in EFFECTS.values() if "accelerations" in one.kinds for name in one.terms),
)
def test_four_times_the_steps_of_a_structure_move_the_spool_alike(extra: str) -> None:
    active = (*BASE, extra)
    values = {p.name: p.start for name in active for p in term(name).parameters}
    values |= {**FLUID.values_for(VALVE), **{name: v for name, v in SIZES.items() if name in values}}
    motion = next(one for one in motions_for(FLUID) if one.has(active))
    substeps = steps_a_sample(Point(active, values), 2e-3, 100.0)
    rows = []
    for steps in (substeps, 4 * substeps):
        body = SWEEP.acceleration(half_step_times(0, 2000, 500.0, steps))
        given = {"sample_period": 2e-3, "substeps": steps}
        found, _ = motion.advance(MotionState(), body, motion.row(active, values)[np.newaxis], **given)
        rows.append(found.velocity)
    assert float(np.std(rows[0] - rows[1])) < 1e-4 * float(np.std(rows[1]))
