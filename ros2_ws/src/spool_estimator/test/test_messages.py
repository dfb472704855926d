from __future__ import annotations

from typing import Any

import pytest
from spool_core.errors import InputError
from spool_core.node.messages import nanoseconds, to_quantity
from spool_core.uncertainty import Quantity
from spool_estimator.estimate import State
from spool_estimator.messages import from_description, from_message, to_refit_message
from spool_estimator.refit import Refit, RefitState
from spool_msgs.msg import ModelEstimate, ValveDescription


@pytest.mark.parametrize("state", State)
def test_the_numbers_of_state_are_those_of_the_message(state: State) -> None:
    assert getattr(ModelEstimate, f"STATE_{state.name}") == state.value


def test_the_message_has_no_other_state() -> None:
    names = [name for name in dir(type(ModelEstimate)) if name.startswith("STATE_")]
    assert sorted(names) == sorted(f"STATE_{state.name}" for state in State)


def test_every_field_of_a_refit_is_in_its_message() -> None:
    one, *others = (Quantity(name, "1", 0.5, 0.1) for name in ("k", "objective", "amplitude_ratio", "nrmse"))
    fields: dict[str, Any] = {"model": "coulomb", "state": RefitState.NOT_CONVERGED, "reason": "too short"}
    fields |= {"last_sequence": 11, "window": 3.5, "fitted": ["c"], "correlations": [0.25]}
    fields |= {quantity.name: quantity for quantity in others}
    refit = Refit(stamp=7_000_000_008, parameters=(one,), **fields)
    message = to_refit_message(refit, "valve_1", refits=12, skipped=13)
    fields |= {name: to_quantity(fields[name]) for name in ("objective", "amplitude_ratio", "nrmse")}
    fields |= {"refits": 12, "skipped": 13, "parameters": [to_quantity(one)], "header": message.header}
    found = {name: getattr(message, name) for name in message.get_fields_and_field_types()}
    assert found | {"correlations": list(message.correlations)} == fields
    assert (message.header.frame_id, nanoseconds(message.header.stamp)) == ("valve_1", 7_000_000_008)


def test_a_state_of_a_later_release_counts_as_unknown() -> None:
    assert from_message(ModelEstimate(state=250)).state is State.UNKNOWN


def test_a_description_nobody_filled_is_refused() -> None:
    with pytest.raises(InputError, match="moving_mass"):
        from_description(ValveDescription())
