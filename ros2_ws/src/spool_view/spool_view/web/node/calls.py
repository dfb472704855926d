"""Calls of the services of valves' nodes: asked from any thread, made on the node's."""

from __future__ import annotations

import queue
import time
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from lifecycle_msgs.srv import GetState
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from spool_msgs.srv import AcknowledgeAlarm, ManageBaseline, ResetAlarms, ShelveAlarm, TakeSnapshot
from std_srvs.srv import Trigger

#: s that a node may take to answer; s between two greetings.
PATIENCE, GREET = 5.0, 0.5
#: Nodes whose clients are kept, and calls that may be under way.
MOST_SERVERS, MOST_CALLS = 32, 64
#: Services that can be called, by node and name; there is no way to any other.
SERVICES: dict[str, dict[str, Any]] = {
    "monitor": {
        "acknowledge_alarm": AcknowledgeAlarm,
        "shelve_alarm": ShelveAlarm,
        "reset_alarms": ResetAlarms,
        "manage_baseline": ManageBaseline,
        "get_parameters": GetParameters,
    },
    "estimator": {"analyse_gap": Trigger},
    "recorder": {"take_snapshot": TakeSnapshot},
}
#: Nodes that serve all valves, outside of their namespaces.
SHARED = {"recorder"}


@dataclass(slots=True)
class _Server:
    """A node of a valve: its clients, the one that greets made last."""

    clients: dict[str, Any]
    greeter: Any


@dataclass(slots=True)
class _Call:
    """Call of a service; ``valve`` is empty for a node that serves all."""

    valve: str
    node: str
    service: str
    request: Any
    answer: Future[Any]
    asked: float = field(default_factory=time.monotonic)
    greeted: float = 0.0
    greetings: list[Any] = field(default_factory=list)
    sent: Any = None


class Calls:
    """Calls under way; :meth:`work` has to be called now and then on the node's thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._new: queue.Queue[_Call] = queue.Queue(MOST_CALLS)
        self._calls: list[_Call] = []
        self._servers: OrderedDict[tuple[str, str], _Server] = OrderedDict()

    def ask(self, valve: str, service: str, request: Any) -> Future[Any]:
        """Return the answer to come, ``None`` in it where no node answers; from any thread."""
        node = next(name for name, services in SERVICES.items() if service in services)
        call = _Call("" if node in SHARED else valve, node, service, request, Future())
        try:
            self._new.put_nowait(call)
        except queue.Full:
            call.answer.set_result(None)
        return call.answer

    def work(self) -> None:
        """Bring every call forward."""
        while len(self._calls) < MOST_CALLS:
            try:
                self._calls.append(self._new.get_nowait())
            except queue.Empty:
                break
        if self._calls:
            self._calls = [call for call in self._calls if not self._ended(call)]

    def close(self) -> None:
        """Give up what is under way, and all clients."""
        while not self._new.empty():
            self._calls.append(self._new.get_nowait())
        for call in self._calls:
            _answer(call, None)
        self._calls.clear()
        while self._servers:
            self._forget(next(iter(self._servers)))

    def _ended(self, call: _Call) -> bool:
        if call.sent is not None and call.sent.done():
            _answer(call, None if call.sent.exception() else call.sent.result())
        elif time.monotonic() - call.asked > PATIENCE:
            _answer(call, None)
        elif call.sent is None:
            self._greet(call, self._server(call.valve, call.node))
        return call.answer.done()

    def _greet(self, call: _Call, server: _Server) -> None:
        """Ask the node for its state until it answers: it drops answers to clients that it does not know yet.

        Clients become known in the order they were made, so it knows all earlier ones then.
        """
        if any(one.done() for one in call.greetings):
            call.sent = server.clients[call.service].call_async(call.request)
            return
        now = time.monotonic()
        if now - call.greeted > GREET and server.greeter.service_is_ready():
            call.greeted = now
            call.greetings.append(server.greeter.call_async(GetState.Request()))

    def _server(self, valve: str, node: str) -> _Server:
        key = (valve, node)
        if key not in self._servers:
            path = f"/{valve}/{node}" if valve else f"/{node}"
            clients = {
                name: self._node.create_client(kind, f"{path}/{name}")
                for name, kind in SERVICES[node].items()
            }
            self._servers[key] = _Server(clients, self._node.create_client(GetState, f"{path}/get_state"))
            busy = {(call.valve, call.node) for call in self._calls}
            idle = [one for one in self._servers if one not in busy and one != key]
            for one in idle[: max(0, len(self._servers) - MOST_SERVERS)]:
                self._forget(one)
        self._servers.move_to_end(key)
        return self._servers[key]

    def _forget(self, key: tuple[str, str]) -> None:
        server = self._servers.pop(key)
        for client in (*server.clients.values(), server.greeter):
            self._node.destroy_client(client)


def _answer(call: _Call, result: Any) -> None:
    if not call.answer.done():
        call.answer.set_result(result)
