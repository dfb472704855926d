"""Messages of the estimator: estimates and valves, to and from ROS."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from spool_core.node.messages import from_quantity, nanoseconds, to_quantity, to_time
from spool_msgs.msg import ModelEstimate, ValveDescription, WindowRefit

from spool_estimator.estimate import QUANTITIES, Estimate, State

if TYPE_CHECKING:  # slow to load
    from spool_sim.valve import Valve

    from spool_estimator.refit import Refit

_NUMBERS = ("model", "last_sequence", "samples", "delay", "memory", "lost_blocks", "refused_blocks")

_VALVE_NUMBERS = tuple(
    name for name, kind in ValveDescription.get_fields_and_field_types().items() if kind == "double"
)


def to_message(estimate: Estimate, valve_id: str) -> ModelEstimate:
    """Return ``estimate`` of the valve ``valve_id`` as a message."""
    message = ModelEstimate(
        state=int(estimate.state),
        parameters=[to_quantity(quantity) for quantity in estimate.parameters],
        **{name: getattr(estimate, name) for name in _NUMBERS},
        **{name: to_quantity(getattr(estimate, name)) for name in QUANTITIES},
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(estimate.stamp)
    return message


def from_message(message: ModelEstimate) -> Estimate:
    """Return the message's estimate; an unknown state counts as unknown."""
    return Estimate(
        stamp=nanoseconds(message.header.stamp),
        source=message.header.frame_id,
        state=State(message.state) if message.state in set(State) else State.UNKNOWN,
        parameters=tuple(from_quantity(quantity) for quantity in message.parameters),
        **{
            **{name: getattr(message, name) for name in _NUMBERS},
            **{name: from_quantity(getattr(message, name)) for name in QUANTITIES},
        },
    )


def to_refit_message(refit: Refit, valve_id: str, *, refits: int, skipped: int) -> WindowRefit:
    """Return ``refit`` of the valve ``valve_id`` as a message, with what was done and skipped by then."""
    message = WindowRefit(
        state=int(refit.state),
        parameters=[to_quantity(quantity) for quantity in refit.parameters],
        fitted=list(refit.fitted),
        correlations=list(refit.correlations),
        **{name: getattr(refit, name) for name in ("model", "reason", "last_sequence", "window")},
        **{name: to_quantity(getattr(refit, name)) for name in ("objective", "amplitude_ratio", "nrmse")},
        refits=refits,
        skipped=skipped,
    )
    message.header.frame_id = valve_id
    message.header.stamp = to_time(refit.stamp)
    return message


def to_description(valve: Valve) -> ValveDescription:
    """Return ``valve`` as a message, NaN for what is not known; the stamp is the caller's."""
    from spool_sim.valve import components_text  # noqa: PLC0415 - as below

    given = valve.given
    message = ValveDescription(
        oil=valve.oil or "",
        components=components_text(valve),
        **{name: given.get(name, math.nan) for name in _VALVE_NUMBERS},
    )
    message.header.frame_id = valve.id
    return message


def from_description(message: ValveDescription) -> Valve:
    """Return the valve that ``message`` describes.

    Raises:
        InputError: a value is out of range; the key is named.

    """
    from spool_sim.valve import components_of, valve_from_mapping  # noqa: PLC0415 - pydantic; a monitor may never need it

    numbers = {name: getattr(message, name) for name in _VALVE_NUMBERS}
    mapping = {name: value for name, value in numbers.items() if not math.isnan(value)}
    where = "valve description"
    mapping["components"] = components_of(message.components, where)
    return valve_from_mapping({"id": message.header.frame_id, "oil": message.oil or None, **mapping}, where)
