"""Client of the services of a valve's nodes, for commands: meets the node, asks once, waits in bounds."""

from __future__ import annotations

import getpass
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from spool_bag.names import check_valve
from spool_core.errors import InputError

#: s that a running node may take to be found and to answer.
PATIENCE = 5.0


@contextmanager
def client_node(name: str, valve: str) -> Iterator[Node]:
    """Yield a node called ``name`` that talks to the nodes of ``valve``.

    Raises:
        InputError: ``valve`` is no namespace.
    """
    check_valve(valve)
    rclpy.init()
    node = Node(name)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown()


def call(node: Node, server: str, service: str, request: Any, kind: Any) -> Any:
    """Return the answer of the service ``service`` (of type ``kind``) of the node ``server``.

    Args:
        node: that asks.
        server: full name without the first slash, e.g. ``valve_1/monitor`` or ``recorder``.
        service: of ``server``.
        request: of type ``kind.Request``.
        kind: type of the service.

    Raises:
        InputError: no active node answers.
    """
    client = node.create_client(kind, f"/{server}/{service}")
    _meet(node, server)
    until(node, client.service_is_ready, server)
    future = client.call_async(request)
    until(node, future.done, server)
    return future.result()


def until(node: Node, met: Callable[[], object], server: str, patience: float = PATIENCE) -> None:
    """Let ``node`` work until ``met``, of the node ``server``.

    Raises:
        InputError: ``patience`` (s) is over first.
    """
    end = time.monotonic() + patience
    while not met():
        if time.monotonic() > end:
            space, _, name = server.rpartition("/")
            raise InputError(
                f"{space or name}: no active {name} answers in /{space}: is it running, with the same "
                "ROS_DOMAIN_ID?"
            )
        rclpy.spin_once(node, timeout_sec=0.05)


def who_asks(given: str) -> str:
    """Return the name given, else the one that the user is logged in by.

    Raises:
        InputError: neither is known.
    """
    try:
        return given or getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError("--who: say who does this") from error


def _meet(node: Node, server: str) -> None:
    """Ask for its state until the node answers: it drops answers to clients that it does not know yet.

    Clients become known in the order they were made, so it knows all earlier ones then.
    """
    client = node.create_client(GetState, f"/{server}/get_state")
    futures: list[Any] = []
    due = 0.0

    def answered() -> bool:
        nonlocal due
        if time.monotonic() >= due and client.service_is_ready():
            futures.append(client.call_async(GetState.Request()))
            due = time.monotonic() + 1.0
        return any(future.done() for future in futures)

    until(node, answered, server)
