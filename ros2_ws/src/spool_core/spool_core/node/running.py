"""Running of a node: executor, logs, shutdown, and the messages at the start."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import shlex
import sys
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import rclpy
import rclpy.logging
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:
    from rclpy.executors import SingleThreadedExecutor as EventsExecutor

from spool_core.errors import InputError
from spool_core.node.managed_node import AUTOSTART, ManagedNode
from spool_core.node.network import check_middleware, network_warnings
from spool_core.node.parameters import RULES, refuse_other_files, refuse_other_nodes, rule
from spool_core.node.stop import STOP, Phase, StopRequested
from spool_core.system import expanded, private_temporary_folder
from spool_core.text import keep_standard_streams

#: Executor of nodes: the events executor, where rclpy has it, costs a third of the default one.
NodeExecutor = EventsExecutor

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
        words = list(sys.argv[1:] if arguments is None else arguments)
        words = [
            str(expanded(word)) if before == "--params-file" else word
            for before, word in pairwise(["", *words])
        ]
        refuse_unknown_words(words)
        refuse_other_files(words)
        check_middleware()
        _say(ensure_log_folder())
        # Errors of rcl are raised, and reported in one line: not on the console as well.
        set_level = rclpy_implementation.rclpy_logging_set_logger_level
        set_level("rcl", rclpy.logging.LoggingSeverity.FATAL)
        try:
            rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        finally:
            set_level("rcl", rclpy.logging.LoggingSeverity.UNSET)
        node = node_class()
        refuse_other_nodes(words, node.get_fully_qualified_name())
        for warning in network_warnings():
            node.get_logger().warning(warning)
        executor = NodeExecutor()
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
    # What was broken off while it began may be half made.
    if executor is not None:
        executor.shutdown()
    if node is not None:
        try:
            node.trigger_shutdown()
        except REFUSED:  # in the middle of a transition
            node.abandon()
        node.destroy_node()
    return finished(code, compiling=node is not None and node.compiling)


def finished(code: int, *, compiling: bool) -> int:
    """End the rest of a process whose nodes have ended; return its exit ``code``."""
    # A process that analyses is not waited for: what it is at is lost.
    for child in multiprocessing.active_children():
        child.terminate()
    rclpy.try_shutdown()
    STOP.finish()
    if compiling:
        # The interpreter would take itself down beneath the compiler.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def refuse_unknown_words(arguments: Sequence[str]) -> None:
    """Refuse words outside of ``--ros-args ... --``: a node takes none, and rcl ignores them.

    Raises:
        InputError: the words are named, and what to type.

    """
    unknown, of_ros = [], False
    for word in arguments:
        if word == "--ros-args" or (of_ros and word == "--"):
            of_ros = word != "--"
        elif not of_ros:
            unknown.append(word)
    if not unknown:
        return
    said = " ".join(map(shlex.quote, unknown))
    if any(word in (*RULES, "--params-file", "--log-level") or ":=" in word for word in unknown):
        raise InputError(f"options of ROS 2 must follow --ros-args: type --ros-args {said}")
    raise InputError(f"{said}: no option of this program; --help lists its parameters")


def one_line(error: Exception) -> str:
    """Return what is wrong with arguments or parameters, and what to do, without the words of rcl."""
    text = re.sub(r", at /\S+:\d+", "", " ".join(str(error).split()))
    text = text.removeprefix("failed to initialize rcl: ")
    if isinstance(error, rclpy_implementation.UnknownROSArgsError):
        return f"unknown ROS arguments: {text}; --help lists this node's parameters"
    unread = re.search(r"rule: '(-p|--param|-r|--remap) (.*)'\. Error", text)
    if unread is not None:
        return _wrong_rule(unread[1], unread[2])
    file = re.search(r"params file: '--params-file (.*)'\. Error:? ?(.*)", text)
    if file is not None:
        reason = file[2]
        try:
            Path(file[1]).read_bytes()
        except OSError as missing:
            reason = missing.strerror or reason
        return f"--params-file {file[1]}: it cannot be read as a parameter file: {reason}"
    level = re.search(r"log level: '--log-level (.*)'", text)
    if level is not None:
        return f"--log-level {level[1]}: use debug, info, warn, error or fatal"
    trailing = re.search(r"trailing (\S+) flag", text)
    if trailing is not None:
        return f"{trailing[1]}: its value is missing; an example is {_EXAMPLES.get(trailing[1], trailing[1])}"
    if text.startswith("Enclave"):
        return f"{text}; an example is {_EXAMPLES['--enclave']}"
    return text


#: Examples of options of ROS 2.
_EXAMPLES = {
    "-p": "-p autostart:=true", "--param": "--param autostart:=true", "-r": "-r __ns:=/valve_1",
    "--remap": "--remap __ns:=/valve_1", "--params-file": "--params-file valve.yaml",
    "--log-level": "--log-level info", "-e": "-e /valve_1", "--enclave": "--enclave /valve_1",
}  # fmt: skip
#: Parts of a namespace, and of a name of ROS 2.
_NAME = r"[A-Za-z_]\w*"


def _wrong_rule(flag: str, text: str) -> str:
    name, mark, value = text.partition(":=")
    if not mark:
        return f"{flag} {text}: write it with :=, for example {_EXAMPLES[flag]}"
    name = name.rpartition(":")[2]
    if name == "__ns":
        return (
            f"{flag} {text}: {value!r} is no namespace: use letters, digits and single underscores, not a "
            f"digit first, for example {flag} __ns:=/valve_1"
        )
    if name in ("__node", "__name"):
        return (
            f"{flag} {text}: {value!r} is no name of a node: use letters, digits and underscores, not a "
            f"digit first, for example {flag} {name}:=monitor_1"
        )
    if flag in ("-r", "--remap"):
        return (
            f"{flag} {text}: no rule for a topic's name: use letters, digits, underscores and slashes, no "
            f"digit first in a part, for example {flag} acceleration:=press/acceleration"
        )
    if not re.fullmatch(rf"{_NAME}(\.{_NAME})*", name):
        return f"{flag} {text}: {name!r} is no name of a parameter; --help lists this node's parameters"
    quoted = " ".join(map(shlex.quote, rule(name, value)))
    return f"{flag} {text} can't be read as YAML; for a text type {quoted}"


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


def ensure_log_folder() -> str | None:
    """Redirect logs of ROS 2 to a temporary folder if its own is not writable; return one line about that.

    Its own is ``ROS_LOG_DIR``, else ``$ROS_HOME/log``, else ``~/.ros/log``.
    """
    folder, reason = _own(), "no home directory"
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


def _own() -> Path | None:
    named = os.environ.get("ROS_LOG_DIR")
    if named:
        return expanded(named)
    home = os.environ.get("ROS_HOME")
    try:
        return (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:
        return None
