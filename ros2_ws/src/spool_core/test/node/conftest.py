from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from spool_core.node import qos, testing
from spool_core.node.service_calls import ServiceCalls
from std_msgs.msg import String

#: Fixtures that every package's tests of nodes have.
away_from_other_ros_programs = testing.away_from_other_ros_programs
claim_domain, domain_id = testing.claim_domain, testing.domain_id

PROBE = Path(__file__).with_name("probe_node.py")
#: s that a test waits at most: machines are busy.
PATIENCE = 180.0

TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}
STATES = {
    State.PRIMARY_STATE_UNCONFIGURED: "unconfigured",
    State.PRIMARY_STATE_INACTIVE: "inactive",
    State.PRIMARY_STATE_ACTIVE: "active",
}


@pytest.fixture
def environment(domain_id: int) -> dict[str, str]:
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(domain_id),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": ":".join(path for path in sys.path if path),
    }


def command(parameters: dict[str, object]) -> list[str]:
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    return [sys.executable, str(PROBE), "--ros-args", *words]


@pytest.fixture
def probe(environment: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the probe node with these parameters, in a separate process."""
    started: list[subprocess.Popen[str]] = []

    def start(**parameters: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            command(parameters), env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


class Observer:
    """Another node on the same domain: calls the probe's services, hears what it says."""

    def __init__(self, domain_id: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node: Node = rclpy.create_node("observer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.heard: list[str] = []
        self.node.create_subscription(
            String, "said", lambda message: self.heard.append(message.data), qos.state(50)
        )
        self._publisher = self.node.create_publisher(String, "told", qos.samples_offered(50.0))

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"waited {PATIENCE} s for {what}"
            self.executor.spin_once(timeout_sec=0.1)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def becomes_silent(self) -> None:
        """Wait until no message comes for a while: one on its way may come late."""

        def nothing() -> bool:
            self.heard.clear()
            self.spin(0.4)
            return not self.heard

        self.until(nothing, "silence")

    def call(self, service: Any, name: str, request: Any) -> Any:
        calls = ServiceCalls(self.node, PATIENCE)
        answer = calls.ask("/probe", name, request, service)
        while not answer.done():
            calls.work()
            self.executor.spin_once(timeout_sec=0.1)
        calls.close()
        assert answer.result() is not None, f"no answer of {name} in {PATIENCE} s"
        return answer.result()

    def state(self) -> str:
        answer = self.call(GetState, "get_state", GetState.Request())
        return STATES.get(answer.current_state.id, answer.current_state.label)

    def change(self, transition: str) -> bool:
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        return bool(self.call(ChangeState, "change_state", request).success)

    def set(self, **values: object) -> tuple[bool, str]:
        parameters = [Parameter(name=name, value=_value(value)) for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        result = self.call(SetParametersAtomically, "set_parameters_atomically", request).result
        return result.successful, result.reason

    def get(self, name: str) -> ParameterValue:
        return self.call(GetParameters, "get_parameters", GetParameters.Request(names=[name])).values[0]

    def describe(self, names: Sequence[str]) -> Any:
        request = DescribeParameters.Request(names=list(names))
        return self.call(DescribeParameters, "describe_parameters", request).descriptors

    def tell(self, text: str) -> None:
        self.until(lambda: self._publisher.get_subscription_count() > 0, "the probe's subscription")
        self._publisher.publish(String(data=text))


def _value(value: object) -> ParameterValue:
    if isinstance(value, bool):
        return ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    if isinstance(value, int):
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, float):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(value))


@pytest.fixture
def observer(domain_id: int) -> Iterator[Observer]:
    made = Observer(domain_id)
    yield made
    made.close()
