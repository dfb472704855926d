"""Running of a node: executor, logs, shutdown, and what is said at the start."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from spool_core.errors import InputError
from spool_core.node.managed_node import AUTOSTART, ManagedNode
from spool_core.node.network import network_warnings
from spool_core.node.parameters import refuse_other_files, rule
from spool_core.node.program import STOP, Phase, StopRequested
from spool_core.system import private_temporary_folder
from spool_core.text import keep_standard_streams

#: s, how long a quiet node may take to notice SIGINT or SIGTERM.
SIGNAL_LATENCY = 0.2

#: What rclpy raises about arguments, parameter files, names and variables: for the user, in one line.
REFUSED = (
    rclpy_implementation.RCLError,
    rclpy_implementation.UnknownROSArgsError,
    NameValidationException,
    ParameterException,
)


def run(node_class: type[ManagedNode], arguments: Sequence[str] | None = None) -> int:
    """Start ``node_class``, spin until SIGINT or SIGTERM, leave it cleaned up; return the exit code.

    With ``autostart`` a node that can't be configured ends with 2 and the reason as its last line. A signal
    while the node starts breaks that off and ends it with 0; further ones do not break the end off.
    """
    if {"-h", "--help"} & set(sys.argv[1:] if arguments is None else arguments):
        print(describe(node_class))
        return 0
    STOP.install()
    keep_standard_streams()
    node, executor, code = None, None, 0
    try:
        STOP.phase = Phase.STARTING
        refuse_other_files(sys.argv if arguments is None else arguments)
        _say(ensure_log_folder())
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = node_class()
        for warning in network_warnings():
            node.get_logger().warning(warning)
        executor = new_executor()
        executor.add_node(node)
        started, done = True, TransitionCallbackReturn.SUCCESS
        if node.value("autostart"):
            started = bool(node.trigger_configure() == done and node.trigger_activate() == done)
        STOP.phase = Phase.RUNNING
        # The events executor spins in the main thread only; Python sees a signal between two turns.
        while started and not STOP.requested:
            executor.spin_once(timeout_sec=SIGNAL_LATENCY)
        code = 0 if started else 2
    except StopRequested:
        pass
    except (InputError, *REFUSED) as error:
        _say(one_line(error))
        code = 2
    STOP.phase = Phase.ENDING
    _end(node, executor)
    STOP.finish()
    if node is not None and node.compiling:
        # The interpreter would take itself down beneath the compiler.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def one_line(error: Exception) -> str:
    """Return what is wrong with arguments or parameters, without the places in rcl's own sources."""
    text = re.sub(r", at /\S+:\d+", "", " ".join(str(error).split()))
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        return f"unknown ROS arguments: {text}; --help lists this node's parameters"
    unread = re.search(r"parameter override rule: '(?:-p|--param) ([\w./*:]+?):=(.*)'\. Error", text)
    if unread is not None:
        quoted = " ".join(map(shlex.quote, rule(unread[1], unread[2])))
        return f"-p {unread[1]}:={unread[2]} can't be read as YAML; for a text type {quoted}"
    return text


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


def new_executor() -> Executor:
    """Return the events executor where rclpy has it: a third of the cost of the default one."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor  # noqa: PLC0415

        return SingleThreadedExecutor()
    return EventsExecutor()


def ensure_log_folder() -> str | None:
    """Let ROS 2 log to a temporary folder where it can't write in its own; return one line about that.

    Its own is ``ROS_LOG_DIR``, else ``$ROS_HOME/log``, else ``~/.ros/log``.
    """
    folder, reason = _own(), "there is no home folder"
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return None
        except OSError as error:
            reason = error.strerror or str(error)
    other = private_temporary_folder("log")
    os.environ["ROS_LOG_DIR"] = str(other)
    return f"log folder {folder or '~/.ros/log'} can't be written ({reason}): logs go to {other}"


def _say(text: str | None) -> None:
    if text:
        with contextlib.suppress(OSError):  # nobody reads it
            print(text, file=sys.stderr, flush=True)


def _end(node: ManagedNode | None, executor: Executor | None) -> None:
    """End what was begun, in order; what was broken off while it began may be half made."""
    if executor is not None:
        executor.shutdown()
    if node is not None:
        try:
            node.trigger_shutdown()
        except REFUSED:  # in the middle of a transition
            node.abandon()
        node.destroy_node()
    # A process that analyses is not waited for: what it is at is lost.
    for child in multiprocessing.active_children():
        child.terminate()
    rclpy.try_shutdown()


def _own() -> Path | None:
    named = os.environ.get("ROS_LOG_DIR")
    if named:
        return Path(named).expanduser()
    home = os.environ.get("ROS_HOME")
    try:
        return (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:
        return None
