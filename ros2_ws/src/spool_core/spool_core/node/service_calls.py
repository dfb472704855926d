"""Calls to services of other nodes: they block nothing, and end with an answer or after a time limit."""

from __future__ import annotations

import queue
import time
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from lifecycle_msgs.srv import GetState
from rclpy.node import Node

#: s that a node may take to be found, and again to answer; s between two greetings.
PATIENCE, GREET = 5.0, 0.5
#: Services whose clients are kept, and calls that may be under way: chosen, they bound the end points.
MOST_SERVICES, MOST_CALLS = 64, 64


class ServiceCalls:
    """Requests under way; :meth:`work` has to be called now and then on the node's thread.

    Args:
        node: that asks.
        patience: s that a node may take to be found, and again to answer.
    """

    def __init__(self, node: Node, patience: float = PATIENCE) -> None:
        self._node, self._patience = node, patience
        self._new: queue.Queue[_Call] = queue.Queue(MOST_CALLS)
        self._calls: list[_Call] = []
        self._clients: OrderedDict[str, tuple[Any, Any]] = OrderedDict()

    def ask(self, server: str, service: str, request: Any, kind: Any) -> Future[Any]:
        """Return the answer to come, ``None`` in it where no node answers; from any thread.

        Args:
            server: full name of a managed node, e.g. ``/valve_1/monitor``.
            service: of ``server``.
            request: of type ``kind.Request``.
            kind: type of the service.
        """
        call = _Call(server, service, request, kind, time.monotonic() + self._patience)
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
        self._calls = [call for call in self._calls if not self._ended(call)]

    def close(self) -> None:
        """Give up what is under way, and all clients."""
        while not self._new.empty():
            self._calls.append(self._new.get_nowait())
        for call in self._calls:
            call.end(None)
        self._calls.clear()
        while self._clients:
            self._forget(next(iter(self._clients)))

    def _ended(self, call: _Call) -> bool:
        if call.sent is not None and call.sent.done():
            call.end(None if call.sent.exception() else call.sent.result())
        elif time.monotonic() > call.due:
            call.end(None)
        elif call.sent is None:
            # A node drops answers to clients that it does not know yet: it is asked for its state first.
            client, greeter = self._clients_of(call)
            now = time.monotonic()
            if any(one.done() for one in call.greetings) and client.service_is_ready():
                call.sent, call.due = client.call_async(call.request), now + self._patience
            elif now - call.greeted > GREET and greeter.service_is_ready():
                call.greeted = now
                call.greetings.append(greeter.call_async(GetState.Request()))
        return call.answer.done()

    def _clients_of(self, call: _Call) -> tuple[Any, Any]:
        """Return the clients of the service and, made last, of its node's state."""
        if call.path not in self._clients:
            client = self._node.create_client(call.kind, call.path)
            greeter = self._node.create_client(GetState, f"{call.server}/get_state")
            self._clients[call.path] = client, greeter
            busy = {one.path for one in (*self._calls, call)}
            idle = [path for path in self._clients if path not in busy]
            for path in idle[: max(0, len(self._clients) - MOST_SERVICES)]:
                self._forget(path)
        self._clients.move_to_end(call.path)
        return self._clients[call.path]

    def _forget(self, path: str) -> None:
        for client in self._clients.pop(path):
            self._node.destroy_client(client)


@dataclass(slots=True)
class _Call:
    """Request to a service; ``due`` is when the next step must be done, s (monotonic)."""

    server: str
    service: str
    request: Any
    kind: Any
    due: float
    answer: Future[Any] = field(default_factory=Future)
    greeted: float = 0.0
    greetings: list[Any] = field(default_factory=list)
    sent: Any = None

    @property
    def path(self) -> str:
        return f"{self.server}/{self.service}"

    def end(self, result: Any) -> None:
        if not self.answer.done():
            self.answer.set_result(result)
