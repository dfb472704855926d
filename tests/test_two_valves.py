"""Two valves in two namespaces never mix, and who joins late gets configuration and state."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
from spool_core.node.messages import from_block
from spool_estimator.estimator_node import EstimatorNode
from spool_monitor.monitor_node import MonitorNode
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, Quantity, ValveHealth
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

from .clocked import START, Domains, clocked

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


@pytest.mark.parametrize("count", [0, 200])
def test_a_late_monitor_gets_the_description_and_the_estimate_that_is_held(
    claim_domain: Domains, count: int
) -> None:
    """Before the first block it has the natural frequency of the valve file."""
    record = Simulator(find_valve("4weh10_stiff"), PRESETS["multisine"], start_stamp=START).records(4.0)
    with clocked(claim_domain, "valve_1") as nodes:
        nodes.listen(ModelEstimate, "estimate")
        nodes.listen(ValveHealth, "health")
        nodes.start(EstimatorNode, valve_file="4weh10_stiff", stale_after=0.2)
        send, estimates = nodes.offer(AccelerationBlock, "acceleration"), nodes.heard["estimate"]
        for block in [*record][:count]:
            send(from_block(block, "4weh10_stiff"))
            nodes.settle()
        stale = ModelEstimate.STATE_STALE
        nodes.until(lambda: not count or (estimates and estimates[-1].state == stale), "it is held")
        nodes.start(MonitorNode, state_folder="none")
        health = nodes.heard["health"]
        nodes.until(lambda: health and health[-1].header.frame_id == "4weh10_stiff", "health comes")
    found, held = health[-1].natural_frequency, estimates[-1].natural_frequency if count else None
    assert found.value == (held.value if held else pytest.approx(28.68, abs=0.01))
    assert found.validity == Quantity.VALIDITY_HELD
    assert health[-1].level == (ValveHealth.LEVEL_STALE if count else ValveHealth.LEVEL_UNKNOWN)
