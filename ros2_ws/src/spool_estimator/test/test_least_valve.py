"""A valve known by mass and springs alone travels in messages and bags, and is estimated."""

from __future__ import annotations

import math

from spool_estimator.estimate import State
from spool_estimator.estimator import Estimator, settings_for
from spool_estimator.messages import from_description, to_description
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve, valve_from_mapping

LEAST = valve_from_mapping({"id": "least", "moving_mass": 0.18, "spring_stiffness": 1632.0})


def test_what_is_not_known_is_nan_on_its_way_and_not_known_again() -> None:
    message = to_description(LEAST)
    assert math.isnan(message.radial_clearance)
    assert message.moving_mass == 0.18
    assert from_description(message) == LEAST
    whole = find_valve("4weh10_soft")
    assert from_description(to_description(whole)) == whole


def test_its_parameters_are_found_as_those_of_a_valve_that_is_known() -> None:
    known = find_valve("4weh10_soft")
    estimator = Estimator(settings_for(LEAST))
    for block in Simulator(known, PRESETS["sweep"]).records(20.0):
        estimator.update(block)
    found = estimator.latest
    assert found is not None
    assert found.state is State.TRACKING
    truth = {"spring_stiffness": 1632.0, "viscous_coefficient": known.viscous_coefficient}
    for one in found.parameters:
        if one.name in truth:
            assert abs(one.value / truth[one.name] - 1.0) < 0.05
