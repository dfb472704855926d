"""Limits of this machine that live operation runs into, each as a finding of `./spool doctor --live`."""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

#: RTPS 2.5, 9.6.2.3: participant n of a domain has the ports 7410 + 250 domain + 2 n and the one above.
FIRST_PORT, DOMAIN_GAIN, PARTICIPANT_GAIN = 7410, 250, 2
#: Participants of a domain on one host that Fast DDS finds a port for (``mutation_tries`` of its source), and
#: from where it is told.
MOST_PARTICIPANTS, MANY_PARTICIPANTS = 100, 80
#: B of shared memory: a segment of each participant and its ports take 1 MB.
LITTLE_SHARED_MEMORY = 64_000_000
#: B, a receive buffer that holds a second of 100 valves' blocks of 400 B at 50 Hz.
SMALL_BUFFER = 2_000_000
#: adjtimex(2): the clock is not synchronised.
_UNSYNCHRONISED = 0x0040


class Finding(NamedTuple):
    """Finding: ``level`` is ``ok``, ``warning`` or ``problem``; ``text`` what was found, and what to do."""

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


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
