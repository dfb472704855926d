"""The nodes from outside: life cycle services, simulated time, parameters."""

from __future__ import annotations

import itertools
import signal
import time
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from spool_core.node.messages import nanoseconds
from spool_msgs.msg import AccelerationBlock, ModelEstimate, ValveHealth
from spool_sim.simulator_node import SimulatorNode

from .clocked import Domains, clocked

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import System, Topic

NANOSECONDS = 1_000_000_000


def test_the_nodes_are_managed_from_outside(system: System, tmp_path: Path) -> None:
    blocks = system.listen(AccelerationBlock, "/valve_1/acceleration")
    estimates = system.listen(ModelEstimate, "/valve_1/estimate", latched=True)
    health = system.listen(ValveHealth, "/valve_1/health", latched=True)
    topics = (blocks, estimates, health)
    _ = system.diagnostics
    own: dict[str, dict[str, object]] = {
        "simulator": {"excitation": "multisine"},
        "recorder": {"output": tmp_path / "bag"},
    }
    nodes = {
        name: system.start(name, autostart=False, **own.get(name, {})).name
        for name in ("recorder", "monitor", "estimator", "simulator")
    }

    for node in nodes.values():
        assert system.state(node) == "unconfigured"
    become_silent(system, *topics, system.diagnostics)
    assert not (tmp_path / "bag").exists()
    for node in nodes.values():
        system.change(node, "configure")
        assert system.state(node) == "inactive"
    become_silent(system, *topics, system.diagnostics)
    assert not (tmp_path / "bag").exists()
    for node in nodes.values():
        system.change(node, "activate")
        assert system.state(node) == "active"
    system.until(
        lambda: estimates.heard and estimates.last.state == ModelEstimate.STATE_TRACKING and health.heard,
        "the active nodes work",
    )
    assert (tmp_path / "bag").is_dir()
    check_that_a_pause_is_no_loss(system, nodes, blocks, estimates)

    stopped = time.monotonic()
    for node in nodes.values():
        system.change(node, "deactivate")
    asleep = {
        "valve_1/estimator: estimate": "inactive: nothing is estimated",
        "valve_1/monitor: condition": "not monitored: the monitor is inactive",
        "valve_1/recorder: recording": "inactive: nothing is recorded",
    }
    for task, told in asleep.items():
        system.until(lambda task=task: system.statuses(task, after=stopped), task)
        system.until(lambda task=task, told=told: system.statuses(task)[-1][1].message == told, told)
        assert system.statuses(task)[-1][1].level == DiagnosticStatus.OK
    # Its latched level must not stay: nobody judges the valve any more.
    system.until(lambda: "inactive" in health.last.summary, "the monitor tells that it is inactive")
    assert health.last.level == ValveHealth.LEVEL_UNKNOWN
    before = estimates.last
    become_silent(system, *topics)  # while inactive they report that they rest
    for node in nodes.values():
        system.change(node, "activate")
    begin = time.monotonic()

    def tracking(estimate: ModelEstimate) -> bool:
        return bool(estimate.state == ModelEstimate.STATE_TRACKING)

    system.until(lambda: estimates.first(tracking, after=begin) and health.heard, "the nodes work again")
    after = estimates.first(tracking, after=begin)
    assert (tmp_path / "bag_1").is_dir()  # each activation has its recording
    # The estimator kept what it had learned, over a source that began again.
    assert after is not None
    assert after.message.samples >= before.samples

    for node in nodes.values():
        system.change(node, "deactivate", "cleanup")
        assert system.state(node) == "unconfigured"
    become_silent(system, *topics, system.diagnostics)
    for node in (nodes["estimator"], nodes["simulator"]):
        system.change(node, "configure", "activate")
    system.until(
        lambda: estimates.heard and estimates.last.samples < before.samples, "a fresh estimator works"
    )
    assert [process.end(signal.SIGTERM) for process in system.processes] == [0, 0, 0, 0]


def check_that_a_pause_is_no_loss(
    system: System, nodes: dict[str, str], blocks: Topic, estimates: Topic
) -> None:
    """Let estimator and monitor rest while the source sends 100 blocks, which they do not count as lost."""

    def lost() -> list[int]:
        return [int(system.numbers(f"valve_1/{task}")["blocks_lost"]) for task in tasks]

    tasks, pausing = ("estimator: estimate", "monitor: data"), (nodes["estimator"], nodes["monitor"])
    system.until(lambda: all(system.numbers(f"valve_1/{task}") for task in tasks), "both count blocks")
    before = lost()
    for node in pausing:
        system.change(node, "deactivate")
    sent = len(blocks.heard)
    system.until(lambda: len(blocks.heard) > sent + 100, "the source goes on")
    for node in pausing:
        system.change(node, "activate")
    begin = time.monotonic()
    system.until(
        lambda: estimates.first(lambda one: one.samples > 0, after=begin), "the estimator works again"
    )
    for task in tasks:
        system.until(lambda task=task: len(system.statuses(f"valve_1/{task}", after=begin)) > 1, task)
    assert all(now - then < 100 for now, then in zip(lost(), before, strict=True))


def become_silent(system: System, *topics: Topic) -> None:
    """Wait until nothing comes on ``topics`` for a second; they are emptied."""

    def nothing() -> bool:  # what was on its way when a service answered still arrives
        for topic in topics:
            topic.heard.clear()
        system.watch(1.2)
        return not any(topic.heard for topic in topics)

    system.until(nothing, "silence")


def test_simulated_time_drives_the_simulator(claim_domain: Domains) -> None:
    with clocked(claim_domain, "valve_1") as nodes:
        nodes.listen(AccelerationBlock, "acceleration")
        nodes.now, heard = 0, nodes.heard["acceleration"]
        nodes.start(SimulatorNode)
        task = "valve_1/simulator: simulation"
        nodes.until(lambda: nodes.status(task).level == DiagnosticStatus.WARN, "it waits for the clock")
        assert not heard
        for begin in (1000, 500, 501):  # back, at last not to before the start
            nodes.now = begin * NANOSECONDS
            nodes.advance(2.0)
            stamps = [nanoseconds(block.header.stamp) for block in heard]
            assert len(stamps) > 80
            assert [block.sequence for block in heard] == list(range(len(heard)))
            assert begin * NANOSECONDS <= stamps[0] < (begin + 0.5) * NANOSECONDS
            assert {later - earlier for earlier, later in itertools.pairwise(stamps)} == {20_000_000}
            assert (begin + 1.8) * NANOSECONDS < stamps[-1] <= (begin + 2.0) * NANOSECONDS
            heard.clear()


@pytest.mark.parametrize(
    ("node", "parameters", "expected"),
    [
        ("estimator", {"valve_file": "4weh11"}, "4weh11: no such valve"),
        ("adapter", {"body_axis": "+q"}, "body_axis: '+q' is no axis of sensor_msgs/msg/Imu: write +x, "),
        ("simulator", {"excitation": "dance"}, "dance: no such excitation"),
        (
            "simulator",
            {"drift_quantity": "colour"},
            "drift_quantity: 'colour' is not one of none, viscous_coefficient",
        ),
        (
            "monitor",
            {"baseline_time": 0.5},
            "/valve_1/monitor: parameter baseline_time = 0.5 is out of range",
        ),
    ],
)
def test_wrong_parameters_end_a_node_in_one_line(
    system: System, node: str, parameters: dict[str, object], expected: str
) -> None:
    process = system.start(node, **parameters)
    assert process.popen.wait(timeout=180) == 2
    assert expected in process.said
    assert "Traceback" not in process.said
    # It reports that it compiles its kernels first where that takes long.
    assert len([line for line in process.said.strip().splitlines() if "kernels" not in line]) == 1
