"""Supervision of real nodes: what never comes, who joins late, and a first start."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from spool_core.node.messages import from_block
from spool_estimator.estimator_node import EstimatorNode
from spool_monitor.monitor_node import MonitorNode
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, Quantity, ValveHealth
from spool_sim.excitation import PRESETS
from spool_sim.simulator import Simulator
from spool_sim.valve import find_valve

from .clocked import START, Domains, clocked

if TYPE_CHECKING:
    from .conftest import System

MONITOR = "/valve_1/monitor"


def test_sensors_that_never_connect_look_wrong(claim_domain: Domains) -> None:
    """Neither a mistyped topic nor a driver that publishes nothing looks like a healthy valve."""
    missing = "nobody publishes on /valve_1/acceleration: start the source or check its topic name"
    with clocked(claim_domain, "valve_1") as nodes:
        nodes.listen(HealthEvent, "events")
        nodes.listen(ValveHealth, "health")
        nodes.start(MonitorNode, state_folder="none")
        health, events = nodes.heard["health"], nodes.heard["events"]
        nodes.until(lambda: health and health[-1].summary == missing, "the topic is named")
        assert health[-1].level == ValveHealth.LEVEL_UNKNOWN
        nodes.offer(AccelerationBlock, "acceleration")
        nodes.until(lambda: events, "the silence is reported")
        assert [(one.kind, one.cause, one.state) for one in events] == [
            ("stale", "never_seen", HealthEvent.STATE_RAISED)
        ]
        nodes.until(lambda: health[-1].level == ValveHealth.LEVEL_STALE, "the health is stale")
        tasks = "monitor: data", "monitor: condition"
        stale = DiagnosticStatus.STALE
        nodes.until(lambda: all(nodes.status(task).level == stale for task in tasks), "both are stale")
        reports = [one for message in nodes.heard["/diagnostics"] for one in message.status]
        assert DiagnosticStatus.OK not in {one.level for one in reports if one.name.endswith(tasks)}


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


#: A monitor with a stand-in for kernels that nobody compiled ahead: they take a minute.
COLD = """
import sys, time
from spool_core.node.program import start
from spool_monitor import monitor_node
monitor_node.warm_up_monitor = lambda: time.sleep(600.0)
sys.exit(start("spool_monitor.monitor_node", "MonitorNode"))
"""


def test_a_first_start_says_that_it_compiles_and_ends_when_asked(system: System) -> None:
    node = system.fork(["-c", COLD], "monitor")
    system.until(lambda: "compiling the numerical kernels" in node.said, "it says so")
    assert node.end(signal.SIGINT) == 0
    assert "Traceback" not in node.said
    assert "alarm" not in node.said
