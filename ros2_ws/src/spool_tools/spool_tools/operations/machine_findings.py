"""What `doctor` finds of this machine, also before anything is set up: standard library only."""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from spool_core.kernels import kernel_files
from spool_core.node.network import DOMAIN_GAIN, LARGEST_DOMAIN, PORT_BASE, WHEELS, network_warnings

#: RTPS 2.5, 9.6.2.3: participant n of a domain has the ports 7410 + 250 domain + 2 n and the one above.
FIRST_PORT, PARTICIPANT_GAIN = PORT_BASE + 10, 2
#: Participants of a domain on one host that Fast DDS finds a port for (``mutation_tries`` of its source), and
#: from which it is reported.
MOST_PARTICIPANTS, MANY_PARTICIPANTS = 100, 80
#: Ports of a domain, of which one has to be free.
PORTS_TRIED = 10
SHARED_MEMORY = Path("/dev/shm")
#: B of shared memory: a segment of each participant and its ports take 1 MB.
LITTLE_SHARED_MEMORY = 64_000_000
SEGMENT_PATTERNS = ("fastrtps_*", "fast_datasharing_*")
#: B, a receive buffer that holds a second of 100 valves' blocks of 400 B at 50 Hz.
SMALL_BUFFER = 2_000_000
#: adjtimex(2): the clock is not synchronised.
_UNSYNCHRONISED = 0x0040


class Finding(NamedTuple):
    """``level`` is ``ok``, ``warning`` or ``problem``; ``text`` what was found, and what to do."""

    level: str
    text: str


def print_findings(findings: Iterable[Finding]) -> int:
    """Print a line for each as it is found; return the exit code: 1 where there is a problem."""
    code = 0
    for level, text in findings:
        print(f"{level:8} {text}", flush=True)
        code |= level == "problem"
    return code


class UdpCounts(NamedTuple):
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


def machine_findings(environment: Mapping[str, str], *, wheels: bool) -> Iterator[Finding]:
    """Yield what this machine and its variables allow, before any node runs.

    Args:
        environment: the user's.
        wheels: whether ROS 2 comes from the wheels of PyPI, which have no DDS security.
    """
    try:
        yield shared_memory_finding(shutil.disk_usage(SHARED_MEMORY).free)
    except OSError:
        yield Finding(
            "warning", f"{SHARED_MEMORY} is not there: Fast DDS falls back to UDP; mount a tmpfs there"
        )
    yield from _reach_findings({**environment, **({WHEELS: "1"} if wheels else {})})
    yield from _kernel_findings(environment)
    yield from _dds_findings(environment)


def load_findings(before: UdpCounts) -> Iterator[Finding]:
    """Yield how near this machine is to its limits while nodes run.

    Args:
        before: UDP counts when the nodes were begun to be listened to.
    """
    given = os.environ.get("ROS_DOMAIN_ID", "0")
    domain = int(given) if given.isdigit() else 0
    yield participants_finding(domain, participants(domain, _text("/proc/net/udp")))
    yield shared_memory_finding(shutil.disk_usage(SHARED_MEMORY).free)
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
        "warning",
        f"{text}: enlarge it (mount -o remount,size=512m /dev/shm; docker: --shm-size=256m), "
        "else blocks go by UDP",
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


def network_problem(domain: int) -> str | None:
    """Return what keeps a participant of a ROS domain from getting its port, None where nothing does."""
    first = FIRST_PORT + DOMAIN_GAIN * domain
    reason = ""
    for port in range(first, first + PARTICIPANT_GAIN * PORTS_TRIED, PARTICIPANT_GAIN):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(("", port))
            return None
        except (OSError, OverflowError) as error:
            reason = str(error)
    return f"no free UDP port from {first} on ({reason}): choose another ROS_DOMAIN_ID"


def left_behind(folder: Path) -> int:
    """Return how many shared-memory segments of Fast DDS no running process maps.

    Args:
        folder: where the system keeps shared memory.
    """
    segments = {str(path) for pattern in SEGMENT_PATTERNS for path in folder.glob(pattern)}
    # Lock files next to the segments are never mapped.
    segments = {name for name in segments if not name.endswith("_el") and "_port" not in name}
    for maps in Path("/proc").glob("[0-9]*/maps") if segments else ():
        try:
            text = maps.read_text()
        except OSError:
            continue
        segments = {name for name in segments if name not in text}
    return len(segments)


def _text(path: str) -> str:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


def _reach_findings(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Yield what the variables say about whom the nodes reach, and who reaches them."""
    if environment.get("ROS_LOCALHOST_ONLY", "0") not in ("", "0"):
        yield Finding(
            "problem",
            "ROS_LOCALHOST_ONLY is set: it is deprecated, and a later ROS 2 may ignore it silently; "
            "unset it and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
        )
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach not in ("", "SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"):
        yield Finding(
            "problem",
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach} is none of "
            "SUBNET, LOCALHOST, OFF, SYSTEM_DEFAULT: set one",
        )
    elif reach == "OFF":
        yield Finding(
            "problem", "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes will not find each other; set LOCALHOST"
        )
    elif reach == "LOCALHOST":
        yield Finding("ok", "discovery range LOCALHOST: nodes find each other on this machine only")
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware not in ("", "rmw_fastrtps_cpp"):
        yield Finding(
            "warning", f"RMW_IMPLEMENTATION={middleware}: the suite is tested with rmw_fastrtps_cpp"
        )
    said = network_warnings(environment)
    yield from (Finding("warning", text) for text in said)
    if not any(name.startswith("ROS_SECURITY_") for name in environment):
        yield Finding(
            "ok", "no ROS_SECURITY_ variable is set: messages and recordings are unencrypted (the default)"
        )
    elif not any("ROS_SECURITY_" in text for text in said):
        yield Finding("ok", "DDS security is enforced")


def _kernel_findings(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Yield who else can change the compiled code that the nodes load."""
    try:
        folder = kernel_files.wanted_kernel_folder(environment)
    except RuntimeError:
        yield Finding("warning", "no home directory: set NUMBA_CACHE_DIR for compiled kernels")
        return
    reason = kernel_files.refusal(folder)
    if reason is None:
        yield Finding("ok", f"compiled kernels are kept in {folder}; only you can write there")
        damaged = kernel_files.damaged_files(folder)
        if damaged:
            yield Finding(
                "warning",
                f"damaged files of compiled kernels: {len(damaged)}, the first is {damaged[0]}: the kernels "
                "are compiled again when they are next needed; if this comes back, check the disk",
            )
    else:
        yield Finding(
            "warning",
            f"compiled kernels are not kept in {folder}: {reason}; they go to a temporary folder and are "
            "compiled again after each boot: set NUMBA_CACHE_DIR to a folder of your own",
        )


def _dds_findings(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Yield what Fast DDS finds of ports and left-over shared memory."""
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not domain.isdecimal() or int(domain) > LARGEST_DOMAIN:
        yield Finding(
            "problem",
            f"ROS_DOMAIN_ID={domain} is no whole number from 0 to {LARGEST_DOMAIN}: "
            "set one, 0 to 101 is safe",
        )
        return
    trouble = network_problem(int(domain))
    yield Finding("problem" if trouble else "ok", trouble or f"UDP ports of ROS domain {domain} can be used")
    count = left_behind(SHARED_MEMORY)
    if count:
        yield Finding(
            "warning",
            f"{count} stale shared-memory files of Fast DDS from exited processes: "
            f"stop ROS 2, then run rm {SHARED_MEMORY}/*fastrtps* {SHARED_MEMORY}/fast_datasharing*",
        )
