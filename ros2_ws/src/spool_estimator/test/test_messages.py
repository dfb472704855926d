from __future__ import annotations

from dataclasses import replace

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from spool_core.errors import InputError
from spool_core.uncertainty import Quantity
from spool_estimator.estimate import State
from spool_estimator.estimator import Estimator
from spool_estimator.messages import from_description, from_message, to_description, to_message
from spool_estimator.stream_estimator import EstimatorSettings
from spool_msgs.msg import ModelEstimate, ValveDescription
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve


@pytest.mark.parametrize("state", State)
def test_the_numbers_of_state_are_those_of_the_message(state: State) -> None:
    assert getattr(ModelEstimate, f"STATE_{state.name}") == state.value


def test_the_message_has_no_other_state() -> None:
    names = [name for name in dir(type(ModelEstimate)) if name.startswith("STATE_")]
    assert sorted(names) == sorted(f"STATE_{state.name}" for state in State)


@pytest.mark.parametrize("seconds", [1.0, 8.0])
def test_an_estimate_survives_the_wire(seconds: float) -> None:
    """While learning (NaN) and while tracking."""
    estimator = Estimator(EstimatorSettings(0.18))
    for block in Simulator(find_valve("4weh10_soft"), PRESETS["multisine"]).records(seconds):
        estimator.update(block)
    assert estimator.latest is not None
    message = deserialize_message(serialize_message(to_message(estimator.latest, "valve_1")), ModelEstimate)
    assert message.header.frame_id == "valve_1"
    sent = replace(
        estimator.latest, residual_force=Quantity("residual_force", "N"), source="valve_1"
    )  # no message has the former
    assert repr(from_message(message)) == repr(sent)


def test_a_state_of_a_later_release_counts_as_unknown() -> None:
    assert from_message(ModelEstimate(state=250)).state is State.UNKNOWN


@pytest.mark.parametrize("name", ["4weh10_soft", "4weh10_stiff"])
def test_a_description_survives_the_wire(name: str) -> None:
    valve = find_valve(name)
    message = deserialize_message(serialize_message(to_description(valve)), ValveDescription)
    assert from_description(message) == valve


def test_a_description_nobody_filled_is_refused() -> None:
    with pytest.raises(InputError, match="moving_mass"):
        from_description(ValveDescription())
