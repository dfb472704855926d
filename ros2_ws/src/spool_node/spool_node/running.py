"""Run one node as a process: start, spin, end cleanly on SIGINT and SIGTERM."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Sequence

import rclpy
from rclpy.executors import Executor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from spool_stream.errors import InputError

from .managed_node import AUTOSTART, ManagedNode

#: s, how long a quiet node may take to notice SIGINT or SIGTERM.
SIGNAL_LATENCY = 0.2


def run(node_class: type[ManagedNode], arguments: Sequence[str] | None = None) -> int:
    """Start ``node_class``, spin until SIGINT or SIGTERM, leave it cleaned up; return the exit code.

    With ``autostart`` a node that can't be configured ends with 2 and the reason as its last line.
    """
    if {"-h", "--help"} & set(sys.argv[1:] if arguments is None else arguments):
        print(describe(node_class))
        return 0
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        node = node_class()
    except InputError as error:
        print(error, file=sys.stderr)
        rclpy.shutdown()
        return 2
    executor = _executor()
    executor.add_node(node)
    if node.value("autostart") and not _start(node):
        return _end(node, executor, 2)
    # The events executor spins in the main thread only; Python sees a signal between two turns.
    while not stop.is_set():
        executor.spin_once(timeout_sec=SIGNAL_LATENCY)
    return _end(node, executor, 0)


def describe(node_class: type[ManagedNode]) -> str:
    """Return what ``--help`` shows: what the node does, its parameters with default, unit and range."""
    lines = [
        (node_class.__doc__ or "").strip().splitlines()[0],
        "",
        "Parameters (--ros-args -p NAME:=VALUE):",
    ]
    for parameter in (AUTOSTART, *node_class.PARAMETERS):
        low, high = parameter.minimum, parameter.maximum
        limits = f", {low:g} to {high:g}" if low is not None and high is not None else ""
        if parameter.choices:
            limits = f", one of {', '.join(parameter.choices)}"
        unit = f" {parameter.unit}" if parameter.unit not in ("", "1") else ""
        lines.append(f"  {parameter.name} = {parameter.default!r}{unit}{limits}")
        lines.append(f"      {parameter.description}")
    return "\n".join(lines)


def _executor() -> Executor:
    """Return the events executor where rclpy has it: a third of the cost of the default one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

        return SingleThreadedExecutor()
    return EventsExecutor()


def _start(node: ManagedNode) -> bool:
    done = TransitionCallbackReturn.SUCCESS
    return bool(node.trigger_configure() == done and node.trigger_activate() == done)


def _end(node: ManagedNode, executor: Executor, code: int) -> int:
    executor.shutdown()
    node.trigger_shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return code
