"""A driven mass is followed by its position: from the force alone, to small forces that add up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from spool_gap.force.force_analyse import analyse_forces
from spool_gap.force.force_record import ForceRecord
from spool_gap.force.position_run import position_rmse, position_run, speed_at
from spool_sim.model import MODELS, Model
from spool_sim.terms import term

PERIOD, MASS, DRAG = 1e-3, 50.0, 120.0
TIME = PERIOD * np.arange(24_000)
AXIS = Model("axis", (term("inertia"), term("viscous_friction")), {"mass": MASS, "viscous_coefficient": DRAG})
FORCE = sum(70.0 * np.sin(2.0 * np.pi * frequency * TIME) for frequency in (0.41, 0.83, 1.37, 2.1))


def driven(model: Model, push: float = 0.0, noise: float = 0.0) -> ForceRecord:
    """Return the record of a mass from rest under ``FORCE`` and a constant ``push``, N."""
    still = ForceRecord("axis", 0.0, PERIOD, np.zeros(TIME.size), FORCE)
    place = position_run(still, (0.0, 0.0), model, -push)
    force = FORCE + noise * np.random.default_rng(3).standard_normal(TIME.size)
    return ForceRecord("axis", 0.0, PERIOD, place, force)


def test_a_constant_force_moves_a_mass_as_its_closed_form() -> None:
    record = ForceRecord("axis", 0.0, PERIOD, np.zeros(TIME.size), np.full(TIME.size, 24.0))
    place = position_run(record, (0.0, 0.0), AXIS, 0.0)
    constant = MASS / DRAG
    exact = 24.0 / DRAG * (TIME + constant * np.expm1(-TIME / constant))
    np.testing.assert_allclose(place, exact, atol=1e-6)


def test_a_run_starts_with_the_velocity_that_the_record_has() -> None:
    record = ForceRecord("axis", 0.0, PERIOD, 0.02 * TIME + 0.3 * TIME**2, np.zeros(TIME.size))
    assert speed_at(record, 0) == pytest.approx(0.02, abs=1e-9)
    assert speed_at(record, 1000) == pytest.approx(0.62, abs=1e-9)


def test_coulomb_friction_and_a_constant_force_are_named_and_the_position_is_followed() -> None:
    hidden = Model("hidden", (*AXIS.terms, term("coulomb_friction")), {**AXIS.values, "coulomb_force": 20.0})
    result = analyse_forces([driven(hidden, -4.0, 0.5)], MODELS["fluid"], "driven")
    assert set(result.verdict.split("+")) - {"unexplained"} == {"coulomb_friction", "constant_force"}
    numbers = {quantity.name: quantity.value for quantity in result.parameters}
    assert numbers["mass"] == pytest.approx(MASS, rel=0.02)
    assert numbers["coulomb_force"] == pytest.approx(20.0, rel=0.05)
    assert numbers["push"] == pytest.approx(-4.0, rel=0.05)
    assert "spring_stiffness" not in numbers
    assert result.after.position_rmse < 0.02 * result.before.position_rmse


def test_a_known_mass_is_not_fitted() -> None:
    result = analyse_forces([driven(AXIS, 0.0, 0.5)], MODELS["fluid"], "driven", mass=MASS)
    assert "mass" not in {quantity.name for quantity in result.parameters}
    assert result.model.values["mass"] == MASS


def test_a_free_run_of_a_model_too_stiff_for_the_record_is_not_known() -> None:
    stiff = Model("stiff", AXIS.terms, {"mass": 1e-9, "viscous_coefficient": 1e5})
    assert math.isnan(position_rmse([driven(AXIS)], stiff, 0.0, 0.0))
