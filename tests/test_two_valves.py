"""Two valves in two namespaces never mix, and who joins late gets configuration and state."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
from spool_msgs.msg import HealthEvent, ModelEstimate, Quantity, ValveDescription, ValveHealth

if TYPE_CHECKING:
    from .conftest import System, Topic

VALVES = {"valve_1": ("4weh10_soft", 1632.0), "valve_2": ("4weh10_stiff", 5846.0)}
SECONDS_OF_DATA = 8


def stiffness(estimate: ModelEstimate) -> Quantity:
    return next(quantity for quantity in estimate.parameters if quantity.name == "spring_stiffness")


def test_two_valves_never_mix(system: System) -> None:
    estimates: dict[str, Topic] = {}
    health: dict[str, Topic] = {}
    events: dict[str, Topic] = {}
    simulators = {}
    for number, (namespace, (valve, _)) in enumerate(VALVES.items()):
        estimates[namespace] = system.listen(ModelEstimate, f"/{namespace}/estimate", latched=True)
        health[namespace] = system.listen(ValveHealth, f"/{namespace}/health", latched=True)
        events[namespace] = system.listen(HealthEvent, f"/{namespace}/events", latched=True)
        system.start("estimator", namespace, valve_file=valve)
        system.start("monitor", namespace)
        simulators[namespace] = system.start(
            "simulator", namespace, valve_file=valve, excitation="multisine", seed=number
        )
    samples = SECONDS_OF_DATA * 2000
    system.until(
        lambda: all(topic.heard and topic.last.samples >= samples for topic in estimates.values()),
        "both estimators have had their data",
    )
    for namespace, (_, true_stiffness) in VALVES.items():
        found = stiffness(estimates[namespace].last)
        assert found.validity == Quantity.VALIDITY_VALID
        assert found.value == pytest.approx(true_stiffness, rel=0.02)
        assert found.unit == "N/m"
        assert 0.0 < found.standard_deviation < 0.02 * true_stiffness

    ended = simulators["valve_1"].end(signal.SIGINT)
    assert ended == 0
    system.until(
        lambda: events["valve_1"].first(lambda event: event.kind == "stale"), "valve_1 says that it is stale"
    )
    system.until(
        lambda: health["valve_1"].last.level == ValveHealth.LEVEL_STALE, "health of valve_1 is stale"
    )
    at_stop = len(health["valve_2"].heard)
    system.until(lambda: len(health["valve_2"].heard) > at_stop + 1, "valve_2 goes on")
    assert health["valve_2"].last.level != ValveHealth.LEVEL_STALE
    assert not events["valve_2"].first(lambda event: event.kind == "stale")
    for namespace, (valve, _) in VALVES.items():
        assert {message.header.frame_id for message in estimates[namespace].messages} == {valve}
        assert {message.header.frame_id for message in events[namespace].messages} <= {valve}
        # Before the description has arrived the monitor knows the valve by its namespace only.
        known = {message.header.frame_id for message in health[namespace].messages}
        assert valve in known
        assert known <= {valve, namespace}


@pytest.mark.slow
def test_a_late_monitor_gets_configuration_and_state(system: System) -> None:
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    system.start("estimator", valve_file="4weh10_stiff")
    simulator = system.start("simulator", valve_file="4weh10_stiff", excitation="multisine")
    system.until(
        lambda: estimates.first(lambda estimate: estimate.state == ModelEstimate.STATE_TRACKING),
        "the estimator has learned",
    )
    assert simulator.end(signal.SIGINT) == 0
    system.until(lambda: estimates.last.state == ModelEstimate.STATE_STALE, "the estimate is held")
    held = estimates.last
    count = len(estimates.heard)

    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    description = system.listen(ValveDescription, "/valve_1/valve", latched=True)
    system.start("monitor")
    system.until(lambda: health.first(lambda state: state.header.frame_id == "4weh10_stiff"), "health comes")
    assert description.last.spring_stiffness == 5846.0
    known = health.first(
        lambda state: state.natural_frequency.standard_deviation == held.natural_frequency.standard_deviation
    )
    assert known is not None
    state = known.message
    assert state.natural_frequency.value == held.natural_frequency.value
    assert state.natural_frequency.validity == Quantity.VALIDITY_HELD
    assert state.level == ValveHealth.LEVEL_STALE
    assert state.dominant_frequency.validity == Quantity.VALIDITY_UNKNOWN
    assert len(estimates.heard) == count, "no new estimate was needed for that"


@pytest.mark.slow
def test_a_late_monitor_of_a_valve_that_never_ran_has_its_description(system: System) -> None:
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    description = system.listen(ValveDescription, "/valve_1/valve", latched=True)
    system.start("estimator", valve_file="4weh10_stiff")
    system.until(lambda: description.heard, "the description is latched")
    system.start("monitor")
    system.until(lambda: health.first(lambda state: state.header.frame_id == "4weh10_stiff"), "health comes")
    state = health.last
    assert state.level == ValveHealth.LEVEL_UNKNOWN
    assert state.natural_frequency.value == pytest.approx(28.68, abs=0.01)
    assert state.natural_frequency.validity == Quantity.VALIDITY_HELD
