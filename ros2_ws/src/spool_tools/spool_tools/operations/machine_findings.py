"""What `doctor --live` finds: limits of this machine, and nodes that do not answer or run late."""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from spool_core.node import qos

#: RTPS 2.5, 9.6.2.3: participant n of a domain has the ports 7410 + 250 domain + 2 n and the one above.
FIRST_PORT, DOMAIN_GAIN, PARTICIPANT_GAIN = 7410, 250, 2
#: Participants of a domain on one host that Fast DDS finds a port for (``mutation_tries`` of its source), and
#: from which it is reported.
MOST_PARTICIPANTS, MANY_PARTICIPANTS = 100, 80
#: B of shared memory: a segment of each participant and its ports take 1 MB.
LITTLE_SHARED_MEMORY = 64_000_000
#: B, a receive buffer that holds a second of 100 valves' blocks of 400 B at 50 Hz.
SMALL_BUFFER = 2_000_000
#: adjtimex(2): the clock is not synchronised.
_UNSYNCHRONISED = 0x0040

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


class Finding(NamedTuple):
    """``level`` is ``ok``, ``warning`` or ``problem``; ``text`` what was found, and what to do."""

    level: str
    text: str


@dataclass(frozen=True, slots=True)
class UdpCounts:
    """UDP counts of the kernel since it started: datagrams that came, and those dropped for a full buffer."""

    received: int
    dropped: int


def participants(domain: int, tables: str) -> int:
    """Return how many DDS participants of ``domain`` this host has.

    Args:
        domain: of ROS.
        tables: text of ``/proc/net/udp``.
    """
    first = FIRST_PORT + DOMAIN_GAIN * domain
    last = FIRST_PORT + DOMAIN_GAIN * (domain + 1) - 10
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in tables.splitlines()[1:] if line.strip()}
    return len({(port - first) // PARTICIPANT_GAIN for port in ports if first <= port < last})


def udp_counts(snmp: str) -> UdpCounts:
    """Return the counts in ``snmp``, the text of ``/proc/net/snmp``."""
    lines = [line.split() for line in snmp.splitlines() if line.startswith("Udp:")]
    if len(lines) < 2:
        return UdpCounts(0, 0)
    counts = dict(zip(lines[0][1:], map(int, lines[1][1:]), strict=True))
    return UdpCounts(counts.get("InDatagrams", 0), counts.get("RcvbufErrors", 0))


def clock_state() -> int:
    """Return the status bits of the system's clock (adjtimex), -1 where they can't be read."""

    class Timex(ctypes.Structure):
        _fields_ = (
            ("modes", ctypes.c_uint),
            ("offset", ctypes.c_long),
            ("freq", ctypes.c_long),
            ("maxerror", ctypes.c_long),
            ("esterror", ctypes.c_long),
            ("status", ctypes.c_int),
            ("rest", ctypes.c_byte * 256),
        )

    state = Timex()
    try:
        failed = ctypes.CDLL(None).adjtimex(ctypes.byref(state)) < 0
    except AttributeError:  # not Linux
        return -1
    return -1 if failed else state.status


def machine_findings(domain: int, before: UdpCounts) -> Iterator[Finding]:
    """Yield what was found on this machine.

    Args:
        domain: of ROS.
        before: UDP counts when the nodes were begun to be listened to.
    """
    yield participants_finding(domain, participants(domain, _text("/proc/net/udp")))
    yield shared_memory_finding(shutil.disk_usage("/dev/shm").free)
    yield buffer_finding(before, udp_counts(_text("/proc/net/snmp")), _text("/proc/sys/net/core/rmem_max"))
    yield clock_finding(clock_state())


def participants_finding(domain: int, count: int) -> Finding:
    """Return the finding for ``count`` participants."""
    text = f"{count} DDS participants of domain {domain} on this host, of {MOST_PARTICIPANTS}"
    if count < MANY_PARTICIPANTS:
        return Finding("ok", text)
    level = "warning" if count < MOST_PARTICIPANTS else "problem"
    return Finding(level, f"{text}: further nodes may not start; run the valves in `spool_bringup host`")


def shared_memory_finding(free: int) -> Finding:
    """Return the finding for ``free`` B in /dev/shm."""
    text = f"shared memory: {free / 1e6:.0f} MB free in /dev/shm"
    if free >= LITTLE_SHARED_MEMORY:
        return Finding("ok", text)
    return Finding(
        "warning", f"{text}: enlarge it (mount -o remount,size=512m /dev/shm), else blocks go by UDP"
    )


def buffer_finding(before: UdpCounts, now: UdpCounts, largest: str) -> Finding:
    """Return the finding for the UDP counts ``before`` and ``now``; ``largest`` is net.core.rmem_max."""
    dropped = now.dropped - before.dropped
    fix = "raise net.core.rmem_max (sysctl -w net.core.rmem_max=8388608)"
    if dropped > 0:
        return Finding("problem", f"{dropped} datagrams were dropped meanwhile, their buffer was full: {fix}")
    size = int(largest) if largest.strip().isdigit() else 0
    text = f"socket buffers: up to {size / 1e6:.2g} MB, none overflowed meanwhile"
    return Finding("ok", text) if size >= SMALL_BUFFER or not size else Finding("warning", f"{text}; {fix}")


def clock_finding(status: int) -> Finding:
    """Return the finding for the ``status`` bits of the clock."""
    if status < 0:
        return Finding("ok", "clock: whether it is synchronised can't be seen here")
    if status & _UNSYNCHRONISED:
        return Finding(
            "warning",
            "clock not synchronised: stamps of other hosts' blocks can't be compared with this one's; "
            "run chrony, systemd-timesyncd or a PTP client",
        )
    return Finding("ok", "clock synchronised")


def ros_domain() -> int:
    """Return the ROS domain of this process."""
    given = os.environ.get("ROS_DOMAIN_ID", "0")
    return int(given) if given.isdigit() else 0


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
        f"{status.name.partition(':')[0]}: {values.get('nodes', math.nan):.0f} nodes, "
        f"{100.0 * share:.0f} % of a core, "
        f"{values.get('resident_B', math.nan) / 1e6:.0f} MB, {waiting:.0f} blocks wait"
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


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


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
