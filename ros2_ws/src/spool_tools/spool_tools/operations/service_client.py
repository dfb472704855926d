"""Calls to the services of running nodes: parameters, baselines, snapshots, the gap analysis."""

from __future__ import annotations

import getpass
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter, ParameterDescriptor, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from spool_bag import check_valve
from spool_core.errors import InputError, operator_missing
from spool_core.events.sentences import language_of
from spool_core.files import YamlError, load_yaml
from spool_core.node import qos
from spool_core.node.parameters import BUILT_IN
from spool_core.node.service_calls import PATIENCE, ServiceCalls
from spool_core.text import did_you_mean
from spool_core.uncertainty import LEGEND, PLUS_MINUS, interval
from spool_monitor.alarm import AlarmState
from spool_monitor.listener import WAITING
from spool_monitor.shown import listed
from spool_msgs import srv
from spool_msgs.msg import AlarmList, GapAnalysis, ValveHealth
from spool_report.outputs import write_file
from spool_report.terminal import Table, wide_console
from std_srvs.srv import Trigger

from spool_tools.operations.valve_rows import alarm_details, alarm_headline

#: Field of a value and Python type, by the type of a parameter.
_FIELDS: dict[int, tuple[str, type, str]] = {
    ParameterType.PARAMETER_BOOL: ("bool_value", bool, "true or false"),
    ParameterType.PARAMETER_INTEGER: ("integer_value", int, "a whole number"),
    ParameterType.PARAMETER_DOUBLE: ("double_value", float, "a number"),
    ParameterType.PARAMETER_STRING: ("string_value", str, "text"),
    ParameterType.PARAMETER_STRING_ARRAY: ("string_array_value", list, "a list of texts, e.g. [a, b]"),
}

#: Services of a monitor by which operators act on alarms.
SERVICES: dict[str, Any] = {
    "acknowledge_alarm": srv.AcknowledgeAlarm,
    "shelve_alarm": srv.ShelveAlarm,
    "suppress_alarm": srv.SuppressAlarm,
    "reset_alarms": srv.ResetAlarms,
}

#: Actions by the words of the command line.
ACTIONS = {
    "show": srv.ManageBaseline.Request.SHOW,
    "learn": srv.ManageBaseline.Request.LEARN,
    "freeze": srv.ManageBaseline.Request.FREEZE,
    "restore": srv.ManageBaseline.Request.RESTORE,
}

#: s that an analysis of the last minute may take: twice its bound on one core, with others working besides.
LONGEST = 300.0


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
    calls = ServiceCalls(node)
    answer = calls.ask(f"/{server}", service, request, kind)
    try:
        while not answer.done():
            calls.work()
            rclpy.spin_once(node, timeout_sec=0.05)
    finally:
        calls.close()
    if answer.result() is None:
        raise _silent(server)
    return answer.result()


def until(node: Node, met: Callable[[], object], server: str, patience: float = PATIENCE) -> None:
    """Spin ``node`` until ``met``; ``server`` is the node that has to answer.

    Raises:
        InputError: ``patience`` (s) is over first.
    """
    end = time.monotonic() + patience
    while not met():
        if time.monotonic() > end:
            raise _silent(server)
        rclpy.spin_once(node, timeout_sec=0.05)


def who_asks(given: str) -> str:
    """Return the name given, else the one that the user is logged in by.

    Raises:
        InputError: neither is known.
    """
    try:
        return given or getpass.getuser()
    except (OSError, KeyError) as error:
        raise InputError(operator_missing("--who")) from error


def list_parameters(valve: str, name: str, only: str | None = None) -> None:
    """Print the parameters of the node ``name`` of ``valve``, or the one called ``only``.

    Raises:
        InputError: no such node answers, or it has no such parameter.
    """
    server = f"{valve}/{name}"
    with client_node("spool_param", valve) as node:
        names = _names(node, server)
        if only is not None:
            _check(server, only, names)
            names = [only]
        values, descriptors = _values(node, server, names)
    rows = [
        (
            one.name, _text(value),
            f"{bounds[0].from_value:g} to {bounds[0].to_value:g}" if bounds else "",
            "; ".join(filter(None, (one.description, one.additional_constraints))),
        )
        for value, one in zip(values, descriptors, strict=True)
        for bounds in ((*one.floating_point_range, *one.integer_range),)
    ]  # fmt: skip
    Table(("parameter", "value", "range", "meaning"), rows).show(wide_console(200))


def set_parameters(valve: str, name: str, changes: Sequence[str]) -> None:
    """Set parameters of the node ``name`` of ``valve``, ``changes`` being NAME=VALUE each, all or none.

    Raises:
        InputError: no such node answers, a change cannot be read, or the node refuses; its reason is given.
    """
    server = f"{valve}/{name}"
    wanted = {}
    for change in changes:
        key, mark, given = change.partition("=")
        key, given = key.strip().removesuffix(":"), given.strip()
        if not (mark and key and given):
            raise InputError(f"{change}: write NAME=VALUE, e.g. coulomb_change=0.2")
        wanted[key] = given
    with client_node("spool_param", valve) as node:
        names = _names(node, server)
        for one in wanted:
            _check(server, one, names)
        before, _ = _values(node, server, list(wanted))
        request = SetParametersAtomically.Request(
            parameters=[
                Parameter(name=one, value=_read(one, text, old.type))
                for (one, text), old in zip(wanted.items(), before, strict=True)
            ]
        )
        result = call(node, server, "set_parameters_atomically", request, SetParametersAtomically).result
        if not result.successful:
            raise InputError(f"{server}: {' '.join(result.reason.split())}")
        after, _ = _values(node, server, list(wanted))
    for one, old, new in zip(wanted, before, after, strict=True):
        print(f"{server}: {one} was {_text(old)}, is {_text(new)}")
    print("This holds until the node ends. Write it to the node's parameter file to keep it.")


def manage_baseline(valve: str, action: str, *, version: int = 0, who: str = "", comment: str = "") -> None:
    """Do ``action`` (of ``ACTIONS``) with the baseline of ``valve`` and print what there is then.

    Raises:
        InputError: no monitor answers, or it refuses; its reason is given.
    """
    request = srv.ManageBaseline.Request(
        action=ACTIONS[action],
        version=version,
        who="" if action == "show" else who_asks(who),
        comment=comment,
    )
    with client_node("spool_baseline", valve) as node:
        answer = call(node, f"{valve}/monitor", "manage_baseline", request, srv.ManageBaseline)
    if not answer.success:
        raise InputError(f"{valve}: {answer.reason}")
    words = [f"{valve}: baseline version {answer.version}, {answer.stage}"]
    words += [f"of {answer.valve_id}"] if answer.valve_id else []
    words += [f"oil {answer.oil}"] if answer.oil else []
    low, high = answer.temperature
    words += [f"learned at {low:.1f} to {high:.1f} deg C"] if math.isfinite(low) else []
    words += [f"confirmed by {answer.frozen_by}"] if answer.frozen_by else []
    console = wide_console(140, markup=False)
    console.print(", ".join(words), soft_wrap=True)
    if not answer.values:
        return
    rows = [
        (one.name, shown.value, shown.half_width, one.unit, count)
        for one, count in zip(answer.values, answer.counts, strict=True)
        for shown in (interval(one.value, one.standard_deviation),)
    ]
    Table(("parameter", "value", PLUS_MINUS, "unit", "estimates"), rows).show(console)
    console.print(f"{LEGEND}, of a single estimate", soft_wrap=True)


def take_snapshot(valve: str, *, who: str, comment: str) -> None:
    """Ask the recorder for a snapshot of ``valve`` and say that it began.

    Raises:
        InputError: no recorder answers, or it refuses; its reason is given.
    """
    request = srv.TakeSnapshot.Request(valve=valve, who=who_asks(who), comment=comment)
    with client_node("spool_snapshot", valve) as node:
        answer = call(node, "recorder", "take_snapshot", request, srv.TakeSnapshot)
    if not answer.success:
        raise InputError(answer.reason)
    print(f"{valve}: the snapshot is being recorded; its bag is made when the time after it is over")


def analyse_live(valve: str, json_file: Path | None) -> None:
    """Ask the estimator of ``valve`` what its model lacks, and print the answer.

    Args:
        valve: namespace.
        json_file: takes everything, as `gap --json` writes it.

    Raises:
        InputError: no estimator answers, it refuses, or the analysis fails; the reason is given.
    """
    with client_node("spool_analyse", valve) as node:
        heard: list[GapAnalysis] = []
        node.create_subscription(GapAnalysis, f"/{valve}/gap", heard.append, qos.state())
        answer = call(node, f"{valve}/estimator", "analyse_gap", Trigger.Request(), Trigger)
        if not answer.success:
            raise InputError(f"{valve}: {answer.message}")
        print(f"{valve}: {answer.message}", flush=True)
        # The last answer is latched: an answer received until now is an earlier one.
        earlier = {_stamp(one) for one in heard}
        until(
            node,
            lambda: any(_stamp(one) not in earlier for one in heard),
            f"{valve}/estimator",
            patience=LONGEST,
        )
        found = next(one for one in reversed(heard) if _stamp(one) not in earlier)
    if found.state != GapAnalysis.STATE_DONE:
        raise InputError(f"{valve}: {found.sentence}")
    if json_file is not None:
        write_file(json_file, json.dumps(json.loads(found.json), indent=2) + "\n", "--json")
    print(f"{found.verdict}  (confidence {found.confidence.value:.2f}, of the last {found.window:.0f} s)")
    print(found.sentence)


def show_alarms(valve: str, *, every: bool, details: bool = False, language: str = "") -> int:
    """Print the strokes and alarms of ``valve``; return 1 where an alarm waits for an operator.

    Args:
        valve: namespace.
        every: normal ones as well.
        details: everything that is known of each, below its headline.
        language: of sentences; see :func:`spool_core.events.sentences.language_of`.

    Raises:
        InputError: no monitor is heard, or there is no such language.
    """
    chosen = language_of(language)
    with client_node("spool_alarm", valve) as node:
        heard: list[AlarmList] = []
        said: list[ValveHealth] = []
        node.create_subscription(AlarmList, f"/{valve}/alarms", heard.append, qos.state())
        node.create_subscription(ValveHealth, f"/{valve}/health", said.append, qos.state())
        until(node, lambda: heard and said, f"{valve}/monitor")
    for part in said[-1].summary.split("; "):
        if part.startswith("switched "):
            print(f"{valve}: {part}")
    found = heard[-1].alarms if every else listed(heard[-1])
    if not found:
        print(f"{valve}: no alarms")
        return 0
    for one in found:
        words = [f"{one.code:4}  {one.name}", AlarmState(one.state).name.lower().replace("_", " ")]
        raised = datetime.fromtimestamp(one.raised_at.sec, timezone.utc)
        words += [f"raised {raised:%Y-%m-%d %H:%M:%S} UTC"] if one.raised_at.sec else []
        words += [f"acknowledged by {one.acknowledged_by}"] if one.acknowledged_by else []
        words += [f"by {one.hidden_by}"] if one.hidden_by else []
        print(", ".join(words))
        if one.message:
            print(f"      {alarm_headline(one, chosen)}")
            for line in alarm_details(one, chosen) if details else ():
                print(f"        {line}")
    return 1 if any(one.state in WAITING for one in found) else 0


def ask(valve: str, service: str, *, who: str, **fields: object) -> None:
    """Call a service of the valve's monitor and say what changed.

    Args:
        valve: namespace.
        service: one of ``SERVICES``.
        who: does it; empty: the one that the user is logged in by.
        fields: of the request.

    Raises:
        InputError: no monitor answers, or it refuses; its reason is given.
    """
    kind = SERVICES[service]
    request = kind.Request(who=who_asks(who), **fields)
    with client_node("spool_alarm", valve) as node:
        answer = call(node, f"{valve}/monitor", service, request, kind)
    if not answer.success:
        raise InputError(f"{valve}: {answer.reason}")
    print(f"{valve}: {', '.join(answer.changed)}")


def _silent(server: str) -> InputError:
    space, _, name = server.rpartition("/")
    return InputError(
        f"{space or name}: no active {name} answers in /{space}: is it running, with the same ROS_DOMAIN_ID?"
    )


def _names(node: Node, server: str) -> list[str]:
    names = call(node, server, "list_parameters", ListParameters.Request(), ListParameters).result.names
    return sorted(one for one in names if one.split(".")[0] not in BUILT_IN)


def _check(server: str, name: str, names: Sequence[str]) -> None:
    if name not in names:
        instead = did_you_mean(name, names) or f"; it has: {', '.join(names)}"
        raise InputError(f"{server}: no parameter {name}{instead}")


def _values(
    node: Node, server: str, names: Sequence[str]
) -> tuple[list[ParameterValue], list[ParameterDescriptor]]:
    values = call(node, server, "get_parameters", GetParameters.Request(names=names), GetParameters).values
    request = DescribeParameters.Request(names=names)
    return values, call(node, server, "describe_parameters", request, DescribeParameters).descriptors


def _read(name: str, text: str, kind: int) -> ParameterValue:
    """Return ``text`` as a value of the type ``kind``, as ROS 2 reads it."""
    if kind not in _FIELDS:
        raise InputError(f"{name}: parameters of this type are set in the parameter file only")
    attribute, wanted, meant = _FIELDS[kind]
    try:
        value: Any = text if wanted is str else float(text) if wanted is float else load_yaml(text)
    except (ValueError, YamlError):
        value = None
    texts = not isinstance(value, list) or all(isinstance(one, str) for one in value)
    if type(value) is not wanted or not texts:
        raise InputError(f"{name}={text}: give {meant}")
    return ParameterValue(type=kind, **{attribute: value})


def _text(value: ParameterValue) -> str:
    return str(parameter_value_to_python(value))


def _stamp(message: GapAnalysis) -> tuple[int, int]:
    return message.header.stamp.sec, message.header.stamp.nanosec
