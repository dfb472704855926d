"""Real nodes as separate processes, and a test node that watches and drives them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from spool_core.node.service_calls import ServiceCalls
from spool_tools.operations.node_processes import find_executable

from .clocked import PATIENCE
from .forks import Fork, completed, server

if TYPE_CHECKING:
    from spool_evaluation.pictures.structure import Module

PACKAGES = {
    "simulator": "spool_sim",
    "estimator": "spool_estimator",
    "monitor": "spool_monitor",
    "recorder": "spool_bag",
    "opcua": "spool_view",
    "adapter": "spool_bag",
}
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}


@dataclass(frozen=True, slots=True)
class Heard:
    """A message and when it arrived, s on the monotonic clock."""

    arrival: float
    message: Any


@dataclass(slots=True)
class Topic:
    """The messages received on one topic so far."""

    heard: list[Heard] = field(default_factory=list)

    @property
    def messages(self) -> list[Any]:
        return [one.message for one in self.heard]

    @property
    def last(self) -> Any:
        return self.heard[-1].message

    def first(self, wanted: Callable[[Any], bool], *, after: float = 0.0) -> Heard | None:
        """Return the first message that arrived ``after`` and is ``wanted``."""
        fitting = (one for one in self.heard if one.arrival >= after and wanted(one.message))
        return next(fitting, None)


@dataclass(slots=True)
class Process:
    """One node."""

    name: str
    popen: subprocess.Popen[bytes] | Fork
    log: Path

    @property
    def alive(self) -> bool:
        return self.popen.poll() is None

    @property
    def said(self) -> str:
        return self.log.read_text(errors="replace", encoding="utf-8")

    def end(self, number: int = signal.SIGINT) -> int:
        """Send a signal and return the exit code."""
        self.popen.send_signal(number)
        return self.popen.wait(timeout=PATIENCE)

    def kill(self) -> float:
        """End the node as a crash does; return when."""
        now = time.monotonic()
        self.popen.kill()
        self.popen.wait(timeout=PATIENCE)
        return now


class System:
    """Nodes on a separate domain."""

    #: Whether nodes are forks of a process that has everything loaded, not separate processes.
    forks = True

    def __init__(self, domain_id: int, folder: Path) -> None:
        self.domain_id = domain_id
        self.folder = folder
        self.processes: list[Process] = []
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = Node(f"observer_{domain_id}", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self._diagnostics: Topic | None = None

    # Processes.

    @property
    def environment(self) -> dict[str, str]:
        """Variables of every process: this domain, and a separate state folder."""
        own = {"XDG_STATE_HOME": str(self.folder / "state"), "ROS_DOMAIN_ID": str(self.domain_id)}
        return {**os.environ, **own}

    def start(self, executable: str, namespace: str = "valve_1", **parameters: object) -> Process:
        """Start a node as `ros2 run` does."""
        arguments = ["--ros-args", "-r", f"__ns:=/{namespace}"]
        for name, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ["-p", f"{name}:={text}"]
        command = [str(find_executable(PACKAGES[executable], executable)), *arguments]
        name = f"/{namespace}/{executable}".replace("//", "/")
        return self.fork(command, name) if self.forks else self.run(command, name)

    def fork(self, command: Sequence[str], name: str) -> Process:
        """Start a Python program as `run` does, but as a fork."""
        with self._log(name).open("wb") as output:
            popen = server().start(command, folder=self.folder, environment=self.environment, output=output)
        return self._add(name, popen)

    def run(self, command: Sequence[str], name: str) -> Process:
        """Start a program in this domain, with the folder of the test as its working directory."""
        with self._log(name).open("wb") as output:
            popen = subprocess.Popen(
                command,
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        return self._add(name, popen)

    def _log(self, name: str) -> Path:
        return self.folder / f"{len(self.processes)}_{name.rpartition('/')[2]}.log"

    def _add(self, name: str, popen: subprocess.Popen[bytes] | Fork) -> Process:
        self.processes.append(Process(name, popen, self._log(name)))
        return self.processes[-1]

    def spool(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run the command line in this domain."""
        command = [str(find_executable("spool_bringup", "spool")), *arguments]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(self.domain_id)}
        return completed(command, folder=Path.cwd(), environment=environment)

    # Messages received.

    def listen(self, kind: type, topic: str, *, latched: bool = False) -> Topic:
        """Subscribe reliably and remember every message."""
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        profile = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        found = Topic()
        self.node.create_subscription(
            kind, topic, lambda message: found.heard.append(Heard(time.monotonic(), message)), profile
        )
        return found

    @property
    def diagnostics(self) -> Topic:
        """Everything on ``/diagnostics`` since this was first asked for."""
        if self._diagnostics is None:
            self._diagnostics = self.listen(DiagnosticArray, "/diagnostics")
        return self._diagnostics

    def statuses(self, task: str, *, after: float = 0.0) -> list[tuple[float, DiagnosticStatus]]:
        """Return the states of one task, each with its arrival."""
        return [
            (one.arrival, status)
            for one in self.diagnostics.heard
            if one.arrival >= after
            for status in one.message.status
            if status.name == task
        ]

    def numbers(self, task: str) -> dict[str, str]:
        """Return the newest values of one task, empty before the first."""
        statuses = self.statuses(task)
        return {value.key: value.value for value in statuses[-1][1].values} if statuses else {}

    def until(self, met: Callable[[], object], what: str, timeout: float = PATIENCE) -> None:
        """Let messages come in until ``met``; fail with what the nodes said."""
        end = time.monotonic() + timeout
        while not met():
            if time.monotonic() > end:
                said = "\n".join(f"--- {process.name}:\n{process.said}" for process in self.processes)
                pytest.fail(f"waited {timeout:g} s in vain: {what}\n{said}")
            self.executor.spin_once(timeout_sec=0.05)

    def watch(self, seconds: float) -> None:
        """Let messages come in for so long, to see that something does not."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=min(0.05, left))

    # Requests to the nodes.

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service of a managed node and return its response."""
        calls = ServiceCalls(self.node, PATIENCE)
        server, _, name = service.rpartition("/")
        answer = calls.ask(server, name, request, kind)

        def answered() -> bool:
            calls.work()
            return answer.done() and answer.result() is not None

        try:
            self.until(answered, f"{service} answers", 2.0 * PATIENCE)
            return answer.result()
        finally:
            calls.close()

    def change(self, node: str, *transitions: str) -> None:
        """Take a managed node through ``transitions``; each must succeed."""
        for name in transitions:
            request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
            assert self.call(ChangeState, f"{node}/change_state", request).success, f"{node}: {name}"

    def state(self, node: str) -> str:
        """Return the label of a managed node's state."""
        return str(self.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label)

    def set_parameters(self, node: str, **values: object) -> list[SetParametersResult]:
        """Set parameters one after the other, in this order."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=parameters)
        return list(self.call(SetParameters, f"{node}/set_parameters", request).results)

    def parameter(self, node: str, name: str) -> Any:
        """Return the value of a parameter of a running node."""
        request = GetParameters.Request(names=[name])
        (value,) = self.call(GetParameters, f"{node}/get_parameters", request).values
        return parameter_value_to_python(value)

    def close(self) -> None:
        for process in self.processes:
            if process.alive:
                process.popen.send_signal(signal.SIGINT)
        for process in self.processes:
            try:
                process.popen.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.popen.kill()
                process.popen.wait()
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(autouse=True, scope="session")
def _state_of_its_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="session")
def modules() -> dict[str, Module]:
    """All modules of the workspace and of research by name, with what they import."""
    from spool_evaluation.pictures.structure import read_modules  # noqa: PLC0415 - slow to load

    root = Path(__file__).resolve().parent.parent
    return read_modules(*(root / name for name in ("ros2_ws/src", "ros2_ws/addons", "research")))


@pytest.fixture(scope="session")
def make_system(
    claim_domain: Callable[[], AbstractContextManager[int]],
) -> Callable[[Path], AbstractContextManager[System]]:
    """Return what makes a system, for fixtures that several tests share."""

    @contextlib.contextmanager
    def make(folder: Path) -> Iterator[System]:
        with claim_domain() as number:
            system = System(number, folder)
            try:
                yield system
            finally:
                system.close()

    return make


@pytest.fixture
def system(make_system: Callable[[Path], AbstractContextManager[System]], tmp_path: Path) -> Iterator[System]:
    """Nodes and an observer on a separate domain."""
    with make_system(tmp_path) as made:
        yield made
