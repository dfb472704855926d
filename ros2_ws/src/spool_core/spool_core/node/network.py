"""ROS domains on this host: a free one for tests, and who can reach the nodes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from spool_core.errors import InputError
from spool_core.system import lock_file, private_temporary_folder

#: Set by what starts the nodes on the wheels from PyPI, whose middleware has no DDS security built in.
WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"

#: Ports of domain d begin at 7400 + 250 d (DDSI-RTPS 2.5, 9.6.2.3: port base and domain gain).
PORT_BASE, DOMAIN_GAIN = 7400, 250
#: Domains in the order of preference. Up to 101 and above 214 they keep clear of the ports 32768 to 60999,
#: which Linux hands out by itself. People use low numbers, so high ones come first.
DOMAINS = (*range(215, 233), *range(101, 0, -1), *range(102, 215))
LARGEST_DOMAIN = 232
#: Tables of the open UDP sockets: one in each line after the first, its local address and port in hexadecimal
#: numbers in the second column (proc(5)).
SOCKET_TABLES = ("/proc/net/udp", "/proc/net/udp6")

#: Locks that this process holds until it ends.
_HELD: list[IO[str]] = []


def network_warnings(environment: Mapping[str, str] | None = None) -> list[str]:
    """Return what lets others in, one sentence each with what to do; none where nothing does.

    Variables as of ROS 2 Jazzy: ``ROS_LOCALHOST_ONLY``, ``ROS_AUTOMATIC_DISCOVERY_RANGE`` (unset: SUBNET),
    ``ROS_STATIC_PEERS``, ``ROS_SECURITY_ENABLE``, ``ROS_SECURITY_STRATEGY`` (unset: Permissive),
    ``ROS_SECURITY_KEYSTORE``.
    """
    environment = os.environ if environment is None else environment
    said = []
    on = environment.get("ROS_SECURITY_ENABLE", "").lower() == "true"
    enforced = on and environment.get("ROS_SECURITY_STRATEGY", "") == "Enforce"
    built_in = not environment.get(WHEELS)
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or "SUBNET"  # the default of Jazzy
    if environment.get("ROS_LOCALHOST_ONLY", "") == "1":  # Jazzy obeys it and ignores the two others
        return _security(environment, on=on, enforced=enforced, built_in=built_in)
    if reach in ("SUBNET", "SYSTEM_DEFAULT") and not (enforced and built_in):
        said.append(
            f"discovery range {reach}: anyone on this network may read the samples, acknowledge and shelve "
            "alarms; set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or give the machine a separate network"
        )
    peers = environment.get("ROS_STATIC_PEERS", "")
    if peers and not (enforced and built_in):
        said.append(f"ROS_STATIC_PEERS={peers}: each of these hosts may acknowledge and shelve alarms")
    return [*said, *_security(environment, on=on, enforced=enforced, built_in=built_in)]


def check_middleware(environment: Mapping[str, str] | None = None) -> None:
    """Refuse a middleware or domain that cannot be: ROS 2 would end the process without saying what to do.

    Raises:
        InputError: ``RMW_IMPLEMENTATION`` is not installed, or ``ROS_DOMAIN_ID`` is no domain.
    """
    environment = os.environ if environment is None else environment
    wanted = environment.get("RMW_IMPLEMENTATION", "")
    index = "share/ament_index/resource_index"
    prefixes = [Path(one) for one in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if one]
    if wanted and prefixes and not any((one / index / "packages" / wanted).exists() for one in prefixes):
        found = {
            file.name for one in prefixes for file in (one / index / "rmw_typesupport_cpp").glob("rmw_*")
        }
        has = ", ".join(sorted(found - {"rmw_implementation"})) or "none"
        raise InputError(
            f"RMW_IMPLEMENTATION={wanted} is not installed; this ROS 2 has {has}: "
            "unset RMW_IMPLEMENTATION, or install that middleware"
        )
    domain = environment.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.strip().isdecimal() and int(domain) <= LARGEST_DOMAIN):
        raise InputError(
            f"ROS_DOMAIN_ID={domain} is no domain: set it to a number from 0 to {LARGEST_DOMAIN}"
        )


def isolate() -> int:
    """Limit this process and its children to this machine and to a separate domain.

    ``ROS_DOMAIN_ID`` and ``ROS_AUTOMATIC_DISCOVERY_RANGE`` are kept where they are set. The domain is claimed
    until this process ends.

    Returns:
        The domain.

    Raises:
        InputError: no domain is free.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DOMAIN_ID" not in os.environ:
        number, lock = _claim()
        _HELD.append(lock)
        os.environ["ROS_DOMAIN_ID"] = str(number)
    return int(os.environ["ROS_DOMAIN_ID"])


@contextlib.contextmanager
def claimed_domain() -> Iterator[int]:
    """Claim a domain that nobody on this machine uses now.

    Raises:
        InputError: no domain is free.
    """
    number, lock = _claim()
    with lock:
        yield number


def domains_in_use() -> set[int]:
    """Return the domains on whose ports a program on this machine listens, of whatever project and user."""
    ports: list[int] = []
    for table in SOCKET_TABLES:
        with contextlib.suppress(OSError):  # no such table, e.g. without IPv6
            lines = Path(table).read_text(encoding="ascii").splitlines()[1:]
            ports += [int(line.split()[1].rpartition(":")[2], 16) for line in lines]
    return {(port - PORT_BASE) // DOMAIN_GAIN for port in ports if port >= PORT_BASE}


def _security(environment: Mapping[str, str], *, on: bool, enforced: bool, built_in: bool) -> list[str]:
    set_ = sorted(name for name in environment if name.startswith("ROS_SECURITY_") and environment[name])
    if not set_:
        return []
    if not built_in:
        return [
            f"{', '.join(set_)} set, but this ROS 2 (wheels from PyPI) has no DDS security built in: "
            "messages are sent and recorded in clear, and any node can join; install ROS 2's own packages "
            "for that"
        ]
    if not on:
        return [
            f"{', '.join(set_)} set, but ROS_SECURITY_ENABLE is not true: messages are sent and recorded in "
            "clear; set ROS_SECURITY_ENABLE=true and ROS_SECURITY_STRATEGY=Enforce"
        ]
    if not enforced:
        return [
            "ROS_SECURITY_STRATEGY is not Enforce: a node without a key runs unsecured, in clear; "
            "set ROS_SECURITY_STRATEGY=Enforce"
        ]
    return []


def _claim() -> tuple[int, IO[str]]:
    folder = private_temporary_folder("domains")
    for number in DOMAINS:
        lock = (folder / str(number)).open("w")
        try:
            lock_file(lock.fileno(), wait=False)
        except BlockingIOError:
            lock.close()
            continue
        # Asked after the lock: a program of ours that has just released it may still be closing its ports.
        if number not in domains_in_use():
            return number, lock
        lock.close()
    raise InputError("no ROS domain is free: end other ROS 2 programs, or set ROS_DOMAIN_ID")
