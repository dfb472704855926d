"""What `doctor --live` finds of the running nodes: which do not answer, run late or report faults."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Mapping

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from spool_core.node import qos

from spool_tools.operations.machine_findings import Finding

#: Share of a core from which a process of a host can't take more: Python runs one thread at a time.
FULL = 0.8
#: s that blocks may be older when their turn comes: a period of the slowest usual source.
OLD = 0.1
#: s between two looks for publishers that appeared, and that are waited forever new ones.
LOOK, LONGEST_SETTLING = 0.1, 30.0
#: Lines of valves that are listed one by one.
TOLD = 10
_LEVELS = {
    DiagnosticStatus.WARN: "warning",
    DiagnosticStatus.ERROR: "problem",
    DiagnosticStatus.STALE: "warning",
}


def listen(seconds: float) -> dict[str, DiagnosticStatus]:
    """Return the last status of each task that is published within ``seconds``.

    Counting restarts with each task and new publisher, as nodes of a busy machine find each other late.
    """
    heard: dict[str, DiagnosticStatus] = {}

    def take(message: DiagnosticArray) -> None:
        heard.update({status.name: status for status in message.status})

    rclpy.init()
    node = rclpy.create_node("spool_doctor")
    try:
        node.create_subscription(DiagnosticArray, "/diagnostics", take, qos.diagnostics())
        found = 0
        end, last = (time.monotonic() + one for one in (seconds, seconds + LONGEST_SETTLING))
        while (now := time.monotonic()) < end:
            rclpy.spin_once(node, timeout_sec=min(end - now, LOOK))
            there = len(heard) + node.count_publishers("/diagnostics")
            if there > found:
                found, end = there, min(time.monotonic() + seconds, last)
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return heard


def node_findings(heard: Mapping[str, DiagnosticStatus]) -> Iterator[Finding]:
    """Yield what the tasks in ``heard`` tell, by name."""
    if not heard:
        yield Finding(
            "warning", "no node publishes on /diagnostics: is one running, in this domain and range?"
        )
        return
    parts = {name: name.partition(": ") for name in heard}  # node and task
    hosts = {
        name
        for name, (node, _, task) in parts.items()
        if task == "host" and node.rpartition("/")[2].startswith("host")
    }
    prefixes = tuple(f"{name.partition(':')[0]}:" for name in hosts)
    valves = {name for name in heard if name.startswith(prefixes)} - hosts if hosts else set()
    for name in sorted(hosts):
        yield host_finding(heard[name])
    if valves:
        yield from valve_findings([heard[name] for name in sorted(valves)])
    others = [heard[name] for name in sorted(heard) if name not in hosts | valves]
    wrong = [status for status in others if status.level in _LEVELS]
    if others:
        yield Finding(
            "ok", f"{len(others) - len(wrong)} of {len(others)} tasks of the nodes are as they should be"
        )
    yield from _some([Finding(_LEVELS[status.level], f"{status.name}: {status.message}") for status in wrong])


def host_finding(status: DiagnosticStatus) -> Finding:
    """Return the finding for one process of a host."""
    values = _values(status)
    share, waiting = values.get("cpu_share", math.nan), values.get("jobs_waiting", math.nan)
    text = (
        f"{status.name.partition(':')[0]}: {values.get('nodes', math.nan):.0f} nodes, {100.0 * share:.0f} % "
        f"of a core, {values.get('resident_B', math.nan) / 1e6:.0f} MB, {waiting:.0f} blocks wait"
    )
    if status.level == DiagnosticStatus.ERROR:
        return Finding("problem", f"{text}; {status.message}")
    if share > FULL:
        return Finding("warning", f"{text}: spread its valves over more processes (host --processes N)")
    return Finding("ok", text)


def valve_findings(statuses: Iterable[DiagnosticStatus]) -> Iterator[Finding]:
    """Yield how old the hosted valves' blocks are, and which came late or were lost."""
    found = [(status, _values(status)) for status in statuses]
    oldest, last = max(
        ((values.get("block_age_s", math.nan), status.name) for status, values in found),
        key=lambda one: -math.inf if math.isnan(one[0]) else one[0],
    )
    late, lost = (sum(values.get(key, 0.0) for _, values in found) for key in ("blocks_late", "blocks_lost"))
    text = (
        f"{len(found)} valves are hosted: blocks at most {1e3 * oldest:.0f} ms old when their turn comes "
        f"({last.rpartition(' ')[2]}); since the start {late:.0f} late by a period, {lost:.0f} lost"
    )
    yield (
        Finding("ok", text)
        if oldest <= OLD
        else Finding("warning", f"{text}: the host is too busy, or the source's clock is another one")
    )
    yield from _some(
        [
            Finding("warning", f"{status.name.rpartition(' ')[2]}: {status.message}")
            for status, _ in found
            if status.level in _LEVELS
        ]
    )


def _some(findings: list[Finding]) -> Iterator[Finding]:
    yield from findings[:TOLD]
    if len(findings) > TOLD:
        yield Finding("warning", f"and {len(findings) - TOLD} more of this kind")


def _values(status: DiagnosticStatus) -> dict[str, float]:
    found = {}
    for one in status.values:
        try:
            found[one.key] = float(one.value)
        except ValueError:
            continue
    return found
