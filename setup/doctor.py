"""`./spool doctor`: what is wrong with this machine or installation, and what to do."""

from __future__ import annotations

import importlib
import os
import shutil
import socket
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from setup import packages, requirements, workspace
from setup.layout import Layout, SetupError
from setup.process import ask
from setup.requirements import NEEDED_BYTES, PYTHON, SetupState
from setup.workspace import package_fingerprints

SHARED_MEMORY = Path("/dev/shm")
SHARED_MEMORY_BYTES = 64_000_000
IMPORTS = "import rclpy, spool_msgs.msg as m; m.AccelerationBlock()"
HELP = """Usage: ./spool doctor [--live [--seconds S]]

Checks machine and installation; each line is ok, warning or problem, with what to do.
With --live it listens to the running nodes and says what they and this machine are short of.
Exit code 1 where there is a problem.
Example: ./spool doctor --live --seconds 10
"""

# RTPS 2.5, 9.6.2.3: port = 7400 + 250 * domain + offset, one pair for every participant of the machine.
FIRST_PORT = 7400
DOMAIN_GAIN = 250
UNICAST_OFFSET = 10
PARTICIPANTS = 10
SEGMENT_PATTERNS = ("fastrtps_*", "fast_datasharing_*")


@dataclass(frozen=True)
class CheckResult:
    """One line of the doctor's report.

    Attributes:
        level: "ok", "warning" or "problem".
        text: what was looked at, what was found, and what to do.
    """

    level: str
    text: str


def doctor(layout: Layout, done: SetupState, environment: Mapping[str, str], arguments: list[str]) -> int:
    """Print the report.

    Returns:
        0, or 1 where there is a problem.

    Raises:
        SetupError: there are arguments.
    """
    if arguments in (["--help"], ["-h"]):
        print(HELP, end="")
        return 0
    if arguments:
        raise SetupError(
            f"doctor takes --live and no other argument, got {' '.join(arguments)}: call ./spool doctor"
        )
    levels = []
    for result in _examine(layout, done, environment):
        print(f"{result.level:8} {result.text}", flush=True)
        levels.append(result.level)
    return int("problem" in levels)


def network_problem(domain: int) -> str | None:
    """What keeps a participant of a ROS domain from getting its port, None where nothing does."""
    first = FIRST_PORT + DOMAIN_GAIN * domain + UNICAST_OFFSET
    reason = ""
    for port in range(first, first + 2 * PARTICIPANTS, 2):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(("", port))
            return None
        except (OSError, OverflowError) as error:
            reason = str(error)
    return f"no free UDP port from {first} on ({reason}): choose another ROS_DOMAIN_ID"


def left_behind(folder: Path) -> int:
    """How many shared-memory segments of Fast DDS no running process maps.

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


def _examine(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """All results, machine first."""
    yield from _machine(layout, done, environment)
    yield from _ros_variables(environment)
    yield from _exposure(layout, environment)
    yield from _dds(environment)
    yield from _installation(layout, done, environment)


def _machine(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """Python, compiler, make, disk, memory."""
    try:
        requirements.check_machine(layout, environment)
        version = ".".join(map(str, sys.version_info[:3]))
        yield CheckResult("ok", f"Python {version} at {PYTHON}, with headers")
        yield CheckResult("ok", "compiler and make")
    except SetupError as error:
        # What is built already runs without a compiler.
        yield CheckResult(
            "warning"
            if done.environment and requirements.missing_tools(environment.get("PATH"))
            else "problem",
            str(error),
        )
    free = shutil.disk_usage(layout.root).free
    enough = bool(done.lock) or free >= NEEDED_BYTES
    advice = "" if enough else f": the set-up takes {NEEDED_BYTES / 1e9:.0f} GB, free some space"
    yield CheckResult(
        "ok" if enough else "problem", f"disk: {free / 1e9:.1f} GB free at {layout.root}{advice}"
    )
    try:
        shared = shutil.disk_usage(SHARED_MEMORY).free
    except OSError:
        yield CheckResult(
            "warning", f"{SHARED_MEMORY} is not there: Fast DDS falls back to UDP; mount a tmpfs there"
        )
        return
    if shared < SHARED_MEMORY_BYTES:
        yield CheckResult(
            "warning",
            f"{SHARED_MEMORY} has {shared / 1e6:.0f} MB free: Fast DDS wants "
            f"{SHARED_MEMORY_BYTES / 1e6:.0f} MB (docker: --shm-size=256m)",
        )
    else:
        yield CheckResult("ok", f"shared memory: {shared / 1e6:.0f} MB free in {SHARED_MEMORY}")


def _ros_variables(environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """Variables that steer discovery."""
    if environment.get("ROS_LOCALHOST_ONLY", "0") not in ("", "0"):
        yield CheckResult(
            "problem",
            "ROS_LOCALHOST_ONLY is set: it is deprecated, and a later ROS 2 may ignore it silently; "
            "unset it and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST",
        )
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if reach not in ("", "SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"):
        yield CheckResult(
            "problem",
            f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach} is none of "
            "SUBNET, LOCALHOST, OFF, SYSTEM_DEFAULT: set one",
        )
    elif reach == "OFF":
        yield CheckResult(
            "problem", "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: nodes will not find each other; set LOCALHOST"
        )
    elif reach == "LOCALHOST":
        yield CheckResult("ok", "discovery range LOCALHOST: nodes find each other on this machine only")
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware not in ("", "rmw_fastrtps_cpp"):
        yield CheckResult(
            "warning", f"RMW_IMPLEMENTATION={middleware}: the suite is tested with rmw_fastrtps_cpp"
        )


def _exposure(layout: Layout, environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """Who else can reach the nodes, and change the code that they load."""
    exposure = _module(layout, "spool_core", "node.network")
    kernels = _module(layout, "spool_core", "kernels.kernel_files")
    seen = {**environment, **({exposure.WHEELS: "1"} if layout.underlay.is_wheels else {})}
    said = exposure.network_warnings(seen)
    yield from (CheckResult("warning", text) for text in said)
    if not any(name.startswith("ROS_SECURITY_") for name in environment):
        yield CheckResult(
            "ok", "no ROS_SECURITY_ variable is set: messages are sent and recorded in clear, as is usual"
        )
    elif not any("ROS_SECURITY_" in text for text in said):
        yield CheckResult("ok", "DDS security is enforced")
    try:
        folder = kernels.wanted_kernel_folder(environment)
    except RuntimeError:
        yield CheckResult("warning", "no home directory: set NUMBA_CACHE_DIR for compiled kernels")
        return
    reason = kernels.refusal(folder)
    if reason is None:
        yield CheckResult("ok", f"compiled kernels are kept in {folder}, which nobody else can write")
        damaged = kernels.damaged_files(folder)
        if damaged:
            yield CheckResult(
                "warning",
                f"damaged files of compiled kernels: {len(damaged)}, the first is {damaged[0]}: the kernels "
                "are compiled again when they are next needed; if this comes back, check the disk",
            )
    else:
        yield CheckResult(
            "warning",
            f"compiled kernels are not kept in {folder}: {reason}; they go to a temporary folder and are "
            "compiled again after each boot: set NUMBA_CACHE_DIR to a folder of your own",
        )


def _module(layout: Layout, package: str, name: str) -> ModuleType:
    """Load a module of the workspace that needs nothing but Python's own library."""
    folder = str(layout.workspace / "src" / package)
    if folder not in sys.path:
        sys.path.append(folder)
    return importlib.import_module(f"{package}.{name}")


def _dds(environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """Ports and shared memory of Fast DDS."""
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not domain.isdecimal() or int(domain) > 232:
        yield CheckResult(
            "problem", f"ROS_DOMAIN_ID={domain} is no whole number from 0 to 232: set one, 0 to 101 is safe"
        )
        return
    trouble = network_problem(int(domain))
    yield CheckResult(
        "problem" if trouble else "ok", trouble or f"UDP ports of ROS domain {domain} can be used"
    )
    count = left_behind(SHARED_MEMORY)
    if count:
        yield CheckResult(
            "warning",
            f"{count} shared-memory files of Fast DDS are left of processes that are gone: "
            f"with no ROS 2 running, rm {SHARED_MEMORY}/*fastrtps* {SHARED_MEMORY}/fast_datasharing*",
        )


def _installation(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """Environment and workspace."""
    yield CheckResult("ok", f"stands on {layout.underlay}")
    try:
        requirements.check_ros(layout, environment)
    except SetupError as error:
        yield CheckResult("problem", str(error))
        return
    if not done.python_version:
        yield CheckResult("warning", "not set up yet: ./spool demo does it")
        return
    reason = requirements.stale(layout, done)
    if reason:
        yield CheckResult("warning", f"{reason}: the next call sets up again")
        return
    if not done.lock:
        yield CheckResult("warning", "the set-up is half finished: the next call goes on with it")
        return
    yield from _packages(layout)
    if not done.environment:
        yield CheckResult("warning", "the workspace is not built yet: the next call does it")
        return
    yield from _workspace(layout, done, environment)


def _packages(layout: Layout) -> Iterator[CheckResult]:
    """The environment against its lock."""
    folder = packages.site_packages(layout)
    found = packages.installed([folder] if folder else [])
    wanted = packages.locked(layout.requirements)
    wrong = [f"{name} {found.get(name, 'missing')} for {version}" for name, version in wanted.items()
             if found.get(name) != version]  # fmt: skip
    if wrong and layout.underlay.is_wheels:
        shown = ", ".join(wrong[:3]) + (f" and {len(wrong) - 3} more" if len(wrong) > 3 else "")
        yield CheckResult(
            "problem",
            f"{layout.venv} differs from the lock ({shown}): delete {layout.venv} and call ./spool demo",
        )
    else:
        yield CheckResult(
            "ok", f"{len(wanted)} packages as locked in {layout.requirements.relative_to(layout.root)}"
        )
    if layout.underlay.is_wheels:
        foreign = workspace.foreign_files(layout)
        yield CheckResult(
            "problem" if foreign else "ok",
            f"{len(foreign)} CMake files name another machine's folders: delete {layout.venv}, call again"
            if foreign
            else "CMake files of the wheels name this machine's folders",
        )
    if "numba" not in found:
        yield CheckResult("warning", "numba is missing: the kernels run uncompiled, many times slower")


def _workspace(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[CheckResult]:
    """The built packages."""
    wanted = package_fingerprints(layout.workspace / "src")
    changed = sorted(
        name for name in wanted.keys() | done.packages.keys() if wanted.get(name) != done.packages.get(name)
    )
    if changed:
        yield CheckResult(
            "warning", f"{', '.join(changed)} changed since the last build: the next call builds"
        )
    else:
        yield CheckResult("ok", f"{len(wanted)} packages of the workspace built and up to date")
    answer = ask([layout.python, "-c", IMPORTS], workspace.run_environment(layout, done, environment))
    if answer.returncode:
        reason = (answer.stderr.strip().splitlines() or ["no message"])[-1]
        yield CheckResult(
            "problem",
            f"rclpy and spool_msgs cannot be imported ({reason}): delete {layout.install} and call again",
        )
    else:
        yield CheckResult("ok", "rclpy and spool_msgs can be imported")
    missing = [name for name in wanted if not _executables_there(layout, name)]
    if missing:
        yield CheckResult(
            "problem",
            f"no executables of {', '.join(missing)} in {layout.install}: delete that folder and call again",
        )
    else:
        yield CheckResult("ok", "the nodes' executables are there")


def _executables_there(layout: Layout, package: str) -> bool:
    """Whether every console script that a package's setup.py names is installed."""
    setup = layout.workspace / "src" / package / "setup.py"
    text = setup.read_text() if setup.exists() else ""
    # Entry points of other groups come after the list.
    scripts = text.partition("console_scripts")[2].partition("]")[0]
    names = [part.split("=")[0].strip() for part in scripts.split('"') if f" = {package}." in part]
    return all(os.access(layout.install / package / "lib" / package / name, os.X_OK) for name in names)
