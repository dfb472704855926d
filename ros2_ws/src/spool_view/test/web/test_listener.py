"""Listener to running valves: whom it finds, what it keeps of them, and that it sends nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from spool_core.cdr import decode_block
from spool_core.node import qos
from spool_monitor import listener as listening
from spool_monitor.listener import Listener
from spool_msgs.msg import AccelerationBlock, AccelerationBlocks

from .conftest import PATIENCE, StandIn


@pytest.fixture(name="node")
def _node(domain_id: int) -> Iterator[Node]:
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = Node("viewer", context=context)
    yield node
    node.destroy_node()
    context.shutdown()


def work(node: Node, listener: Listener, met: Callable[[], object], what: str) -> None:
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    end = time.monotonic() + PATIENCE
    while not met():
        assert time.monotonic() < end, f"waited in vain: {what}"
        listener.look()
        executor.spin_once(timeout_sec=0.05)
        listener.fetch()
    executor.shutdown()


@pytest.mark.parametrize("light", [False, True])
def test_valves_are_found_heard_and_grow_silent(
    node: Node, stand_in: Callable[[str], StandIn], light: bool
) -> None:
    first = stand_in("press/left")
    listener = Listener(node, light=light)
    valves = listener.valves
    work(node, listener, lambda: "press/left" in valves and valves["press/left"].health, "a nested name")
    stand_in("valve_2")
    work(node, listener, lambda: "valve_2" in valves and valves["valve_2"].alarms, "a valve that joins later")
    work(node, listener, lambda: valves["press/left"].condition(time.monotonic()) == "good", "it is good")
    first.close()
    work(node, listener, lambda: valves["press/left"].condition(time.monotonic()) == "no_word", "silence")
    assert valves["valve_2"].condition(time.monotonic()) == "good"
    assert all((valve.estimate is None) == light for valve in valves.values())
    assert not [name for name, _ in node.get_client_names_and_types_by_node("viewer", "/")]
    listener.close()


def test_what_hosts_take_is_kept_for_metrics(node: Node, stand_in: Callable[[str], StandIn]) -> None:
    speaker = stand_in("press/left")
    tasks = {
        "host_1: host": "3.125",
        "host_1: press/left": "1.5",
        "host_1: unheard": "2",
        "a/monitor: host": "9",
    }
    message = DiagnosticArray(
        status=[
            DiagnosticStatus(
                name=name,
                values=[KeyValue(key="cpu_time_s", value=time), KeyValue(key="resident_B", value="2000000")],
            )
            for name, time in tasks.items()
        ]
    )
    message.status.append(DiagnosticStatus(name="host_2: host"))
    publisher = speaker.node.create_publisher(DiagnosticArray, "/diagnostics", qos.diagnostics())
    speaker.node.create_timer(0.1, lambda: publisher.publish(message))
    listener = Listener(node, light=True, metrics=True)
    valves = listener.valves

    def met() -> bool:
        listener.sample_bounds()
        return bool(listener.hosts and "press/left" in valves and valves["press/left"].cost)

    work(node, listener, met, "processor time and memory")
    assert {name: (one.processor_time, one.memory) for name, one in listener.hosts.items()} == {
        "host_1": (3.125, 2e6)
    }
    cost = valves["press/left"].cost
    assert cost is not None
    assert (cost.processor_time, cost.memory) == (1.5, 2e6)
    listener.close()


def test_the_page_shows_a_valve_s_blocks_out_of_a_message_for_many(
    node: Node, stand_in: Callable[[str], StandIn]
) -> None:
    """One of two names and one block, as a fault of the source, is left out."""
    speaker = stand_in("valve_1")
    listener = Listener(node, ("valve_1",), light=True)
    (valve,) = listener.follow(["valve_1"])
    publisher = speaker.node.create_publisher(AccelerationBlocks, "/accelerations", qos.samples_offered(10.0))
    blocks = [AccelerationBlock(sequence=7, sample_period=1e-3, body=[1.0], spool=[x]) for x in (2.0, 3.0)]
    messages = [
        AccelerationBlocks(names=["valve_1", "valve_2"], blocks=blocks[:1]),
        AccelerationBlocks(names=["valve_2", "/valve_1"], blocks=blocks),
    ]
    speaker.node.create_timer(0.1, lambda: [publisher.publish(message) for message in messages])
    work(node, listener, lambda: valve.blocks, "a block")
    found = {(block.sequence, *block.body, *block.spool) for block in map(decode_block, valve.blocks)}
    assert found == {(7, 1.0, 3.0)}
    listener.close()


def test_more_is_kept_of_a_valve_that_is_followed(node: Node, stand_in: Callable[[str], StandIn]) -> None:
    stand_in("valve_1")
    listener = Listener(node, ("valve_1", "valve_2"), light=True)
    valve = listener.valves["valve_1"]
    assert listener.follow(["valve_3", "valve_1"]) == [valve]
    work(node, listener, lambda: valve.estimate and valve.health, "the estimate comes")
    changes = valve.changes
    assert listener.follow([]) == []
    assert valve.estimate is None
    assert valve.changes > changes
    assert valve.health is not None
    assert set(listener.valves) == {"valve_1", "valve_2"}
    listener.close()


def test_valves_are_bounded(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listening, "MOST_VALVES", 2)
    listener = Listener(node, ("a", "b", "c"))
    assert list(listener.valves) == ["a", "b"]
    listener.close()
