"""Supervision of real nodes: what never comes, what dies, what changes while it runs, what the logs say."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from spool_bag.reader import BagReader
from spool_msgs.msg import AccelerationBlock, HealthEvent, ModelEstimate, ValveHealth
from spool_msgs.srv import ManageBaseline

if TYPE_CHECKING:
    from .conftest import System

MONITOR = "/valve_1/monitor"


def test_sensors_that_never_connect_look_wrong(system: System) -> None:
    """Neither a mistyped topic nor a driver that publishes nothing looks like a healthy valve."""
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    _ = system.diagnostics
    system.start("monitor")
    missing = "nobody publishes on /valve_1/acceleration: start the source or check its topic name"
    system.until(lambda: health.first(lambda state: state.summary == missing), "the topic is named")
    assert health.last.level == ValveHealth.LEVEL_UNKNOWN
    system.node.create_publisher(AccelerationBlock, "/valve_1/acceleration", 10)
    system.until(lambda: events.first(lambda event: event.kind == "stale"), "the silence is reported")
    (event,) = events.messages
    assert (event.cause, event.state) == ("never_seen", HealthEvent.STATE_RAISED)
    system.until(lambda: health.last.level == ValveHealth.LEVEL_STALE, "the health is stale")
    for task in ("data", "condition"):
        system.until(
            lambda task=task: (
                system.statuses(f"valve_1/monitor: {task}")[-1][1].level == DiagnosticStatus.STALE
            ),
            f"{task} is stale",
        )
        levels = {status.level for _, status in system.statuses(f"valve_1/monitor: {task}")}
        assert DiagnosticStatus.OK not in levels


@pytest.mark.slow
def test_every_line_is_logged_once_and_changes_of_parameters_are_recorded(
    system: System, tmp_path: Path
) -> None:
    events = system.listen(HealthEvent, "/valve_1/events", latched=True)
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    _ = system.diagnostics
    monitor = system.start("monitor", baseline_time=3.0)
    estimator = system.start("estimator")
    recorder = system.start("recorder", "", output=tmp_path / "bag", valves="[valve_1]")
    simulator = system.start("simulator", excitation="multisine", wait_for_subscribers=3)
    system.until(
        lambda: estimates.heard and estimates.last.state == ModelEstimate.STATE_TRACKING, "the valve is known"
    )

    taken = system.set_parameters(MONITOR, amplification_on=2.5, amplification_off=1.9)
    assert [one.successful for one in taken] == [True, True]

    system.until(lambda: "baseline version 1 of 4weh10_soft learned" in monitor.said, "a baseline is learned")
    request = ManageBaseline.Request(action=ManageBaseline.Request.FREEZE, who="Eva", comment="as delivered")
    assert system.call(ManageBaseline, f"{MONITOR}/manage_baseline", request).success
    simulator.end()
    system.until(lambda: events.first(lambda event: event.kind == "stale"), "the silence is an alarm")
    system.until(lambda: "No acceleration: silence " in monitor.said, "it is logged")
    assert [recorder.end(), monitor.end(), estimator.end()] == [0, 0, 0]

    published = {status.name for one in system.diagnostics.messages for status in one.status}
    assert published - {"valve_1/simulator: simulation"} == expected_by_the_aggregator("valve_1", "recorder")

    assert "baseline changed by Eva: frozen (as delivered)" in monitor.said
    assert monitor.said.count("learned") == 1
    (line,) = [line for line in monitor.said.splitlines() if "No acceleration: silence " in line]
    assert line.startswith("[ERROR]")
    assert re.search(r"configured for valve 4weh10_soft \(4weh10_soft\): 180 g, 15\.\d Hz", estimator.said)
    for process in (monitor, estimator, simulator, recorder):
        assert process.said.count(": active\n") == 1
    changes = [
        (changed.name, Parameter.from_parameter_msg(changed).value)
        for message in BagReader(tmp_path / "bag").messages("/parameter_events")
        if message.node == MONITOR
        for changed in message.changed_parameters
    ]
    assert ("amplification_on", 2.5) in changes
    assert ("amplification_off", 1.9) in changes


def expected_by_the_aggregator(*groups: str) -> set[str]:
    """Return the tasks whose silence the shipped configuration of the aggregator would show."""
    folder = Path(get_package_share_directory("spool_bringup"))
    content = yaml.safe_load((folder / "config" / "diagnostic_aggregator.yaml").read_text(encoding="utf-8"))
    analyzers = content["analyzers"]["ros__parameters"]
    return {task for group in groups for task in analyzers[group]["expected"]}


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
