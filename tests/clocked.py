"""Real nodes in the process of the test, whose time is a clock that the test sets."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, TypeAlias

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from spool_core.node import qos
from spool_core.node.managed_node import HostContext, ManagedNode
from spool_core.node.messages import to_time

Domains: TypeAlias = Callable[[], AbstractContextManager[int]]
#: s, what is waited for comes much sooner on an idle machine, and still comes on a busy one.
PATIENCE = 180.0
#: ns of the clock: the first time, and what it advances by at once.
START, STEP = 1_700_000_000_000_000_000, 100_000_000


class Clocked:
    """Nodes of one valve, and what an observer heard of them, by topic.

    Another ``valve`` for each that is there at the same time: nodes of a process hand over blocks by topic.
    """

    def __init__(self, context: Context, valve: str) -> None:
        self.context = context
        self.executor = SingleThreadedExecutor(context=context)
        self.observer = rclpy.create_node("observer", namespace=valve, context=context)
        self.executor.add_node(self.observer)
        self.nodes: list[Any] = []
        self.host = HostContext()
        self.heard: dict[str, list[Any]] = defaultdict(list)
        self.offered: list[str] = []
        self.now = START
        self._clock = self.observer.create_publisher(Clock, "/clock", 1)
        self.listen(DiagnosticArray, "/diagnostics")

    def start(self, kind: type[ManagedNode], **parameters: object) -> Any:
        """Return a node that is active, has this clock and knows what is offered."""
        values = {"use_sim_time": True} | parameters
        given = [Parameter(name, value=value) for name, value in values.items()]
        namespace = self.observer.get_namespace()
        node = kind(namespace=namespace, host=self.host, context=self.context, parameter_overrides=given)
        self.nodes.append(node)
        self.executor.add_node(node)
        self.turn()
        self.until(lambda: all(node.count_publishers(one) for one in self.offered), "topics are known")
        for change in (node.trigger_configure, node.trigger_activate):
            assert change() is TransitionCallbackReturn.SUCCESS
        return node

    def listen(self, kind: type, topic: str, *, latched: bool = False) -> None:
        """Hear every message of a topic, as only a reliable subscriber does."""
        profile = qos.profile(5000, reliable=True, latched=latched)
        self.observer.create_subscription(kind, topic, self.heard[topic].append, profile)

    def offer(self, kind: type, topic: str, *, latched: bool = False) -> Callable[[Any], None]:
        """Return what publishes on a topic, to which a node listens if some run."""
        profile = qos.profile(5000, reliable=True, latched=latched)
        publisher = self.observer.create_publisher(kind, topic, profile)
        self.offered.append(publisher.topic_name)
        self.until(lambda: not self.nodes or publisher.get_subscription_count(), f"one listens to {topic}")
        return publisher.publish

    def until(self, met: Callable[[], object], what: str) -> None:
        """Let messages come in until ``met``, and then all that is due."""
        end = time.monotonic() + PATIENCE
        while not met():
            if time.monotonic() > end:
                pytest.fail(f"waited {PATIENCE:g} s in vain: {what}")
            self.executor.spin_once(timeout_sec=0.02)
        self.settle()

    def settle(self) -> None:
        """Let the nodes do all that is due now."""
        worked = True
        while worked:  # a look without waiting ends in this exception, also after work
            worked = False
            with contextlib.suppress(TimeoutException):
                while True:
                    handler, _, _ = self.executor.wait_for_ready_callbacks(timeout_sec=0.0)
                    handler()
                    handler.result()
                    worked = True

    def turn(self) -> None:
        """Let every node know the time that it is, and do what is due."""
        self._clock.publish(Clock(clock=to_time(self.now)))
        known = [node.get_clock() for node in self.nodes if node.get_parameter("use_sim_time").value]
        self.until(lambda: all(clock.now().nanoseconds == self.now for clock in known), "the clock")

    def advance(self, seconds: float) -> None:
        """Let this time pass."""
        for _ in range(round(1e9 * seconds / STEP)):
            self.now += STEP
            self.turn()

    @contextlib.contextmanager
    def spinning(self) -> Iterator[None]:
        """Let the nodes work in a thread meanwhile."""
        ended = threading.Event()

        def spin() -> None:
            while not ended.is_set():
                self.executor.spin_once(timeout_sec=0.02)

        thread = threading.Thread(target=spin)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def status(self, task: str) -> DiagnosticStatus:
        """Return the newest state of a task on ``/diagnostics``, an empty one before the first."""
        statuses = [one for message in self.heard["/diagnostics"] for one in message.status]
        return next((one for one in reversed(statuses) if one.name.endswith(task)), DiagnosticStatus())

    def numbers(self, task: str) -> dict[str, str]:
        """Return the newest values of a task."""
        return {pair.key: pair.value for pair in self.status(task).values}


@contextlib.contextmanager
def clocked(claim_domain: Domains, valve: str) -> Iterator[Clocked]:
    """Make the nodes of one valve on a free ROS domain, and end them."""
    with claim_domain() as number:
        context = Context()
        rclpy.init(context=context, domain_id=number)
        made = Clocked(context, valve)
        try:
            yield made
        finally:
            for node in made.nodes:
                node.trigger_shutdown()
            made.executor.shutdown()
            for node in (*made.nodes, made.observer):
                node.destroy_node()
            rclpy.shutdown(context=context)
