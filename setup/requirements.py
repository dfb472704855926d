"""Requirements on the machine, and the state of the set-up that is kept between calls."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from importlib.util import find_spec

from setup.layout import Layout, SetupError
from setup.process import ask

NEEDED_BYTES = 2_000_000_000
WHEELS_PLATFORM = "linux x86_64"
#: The interpreter that the launcher chose, outside any virtual environment: the environment is made with it.
PYTHON = os.path.realpath(getattr(sys, "_base_executable", sys.executable))
VERSION = ".".join(map(str, sys.version_info[:3]))
SERIES = VERSION.rpartition(".")[0]


def stale(layout: Layout, done: SetupState) -> str | None:
    """Why the environment has to be made again, None where it need not."""
    if not done.python_version:
        return "there is none yet"
    if done.root != str(layout.root):
        return f"the project was moved from {done.root}"
    if done.underlay != list(layout.underlay.prefixes):
        return f"ROS 2 {layout.underlay.name} lies in other folders than before"
    if done.python_version != SERIES:
        return f"Python changed from {done.python_version} to {SERIES}"
    if not os.access(layout.python, os.X_OK):
        return f"{layout.python} is gone"
    if done.lock and done.lock != layout.lock_hash():
        return f"{layout.requirements.relative_to(layout.root)} changed"
    return None


def missing_tools(path: str | None) -> list[str]:
    """Name what PATH lacks of compiler and make."""
    wanted = (
        ("a C++ compiler", (os.environ.get("CXX", "").split(" ")[0], "c++", "g++", "clang++")),
        ("a C compiler", (os.environ.get("CC", "").split(" ")[0], "cc", "gcc", "clang")),
        ("make", ("make",)),
    )
    return [
        tool for tool, names in wanted if not any(name and shutil.which(name, path=path) for name in names)
    ]


def check_machine(layout: Layout, environment: Mapping[str, str]) -> None:
    """Refuse to begin a set-up that cannot end well.

    Raises:
        SetupError: names what is missing and how to get it.
    """
    system = f"{sys.platform} {os.uname().machine}"
    if layout.underlay.is_wheels and system != WHEELS_PLATFORM:
        raise SetupError(
            f"there are ROS 2 wheels for Linux x86-64 only, this is {system}: "
            "install ROS 2 Jazzy from its packages, source it and call again"
        )
    if find_spec("ensurepip") is None:
        raise SetupError(
            f"Python {SERIES} at {PYTHON} cannot make virtual environments (no ensurepip): "
            f"Debian, Ubuntu: apt install python{SERIES}-venv"
        )
    missing = missing_tools(environment.get("PATH"))
    if missing:
        raise SetupError(
            f"not found on PATH: {' and '.join(missing)}: Debian, Ubuntu: apt install build-essential"
        )
    include = sysconfig.get_paths()["include"]
    if not os.path.exists(os.path.join(include, "Python.h")):
        raise SetupError(
            f"Python.h is not in {include}: the messages cannot be compiled without it; "
            f"Debian, Ubuntu: apt install python{SERIES}-dev, or name another Python in SPOOL_PYTHON"
        )


def check_ros(layout: Layout, environment: Mapping[str, str]) -> None:
    """Check that a sourced ROS 2 is really there and speaks with this Python.

    Raises:
        SetupError: it is not, or does not.
    """
    if layout.underlay.is_wheels:
        return
    name = layout.underlay.name
    if not any(os.path.isdir(prefix) for prefix in layout.underlay.prefixes):
        raise SetupError(
            f"ROS_DISTRO={name} is set but AMENT_PREFIX_PATH names no folder that exists: "
            f"source /opt/ros/{name}/setup.bash, or unset ROS_DISTRO to use the wheels"
        )
    if ask([PYTHON, "-c", "import rclpy"], environment).returncode != 0:
        raise SetupError(
            f"ROS 2 {name} is sourced but {PYTHON} cannot import rclpy: "
            "name the Python that this ROS 2 was built for in SPOOL_PYTHON, e.g. /usr/bin/python3"
        )


def check_space(layout: Layout) -> None:
    """Refuse to begin on a disk that will be full before the end.

    Raises:
        SetupError: too little is free.
    """
    free = shutil.disk_usage(layout.root).free
    if not layout.venv.exists() and free < NEEDED_BYTES:
        raise SetupError(
            f"{layout.root} has {free / 1e9:.1f} GB free, the set-up takes {NEEDED_BYTES / 1e9:.0f} GB: "
            "free some space and call again"
        )


def cannot_write(layout: Layout, error: OSError) -> SetupError:
    """The line for a folder that cannot be written."""
    where = error.filename or layout.root
    if error.errno == errno.ENOSPC:
        return SetupError(f"the disk that holds {where} is full: free some space and call again")
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return SetupError(
            f"{where} cannot be written, and something has to be set up there: "
            "make the folder writable, or copy the project to one that is"
        )
    return SetupError(f"{where}: {error.strerror}")


@dataclass
class SetupState:
    """The stamp of a set-up; empty fields are steps not yet done.

    Attributes:
        root: the project's folder at that time; the environment holds absolute paths.
        python_version: "3.x" of the interpreter that made the environment.
        underlay: prefixes of the sourced ROS 2.
        lock: hash of the lock that was installed.
        built: fingerprint of every package that the workspace holds.
        warmed: whether the kernels were compiled.
    """

    root: str = ""
    python_version: str = ""
    underlay: list[str] = field(default_factory=list)
    lock: str = ""
    built: dict[str, str] = field(default_factory=dict)
    warmed: bool = False


def load(layout: Layout) -> SetupState:
    """The stamp, or an empty one where there is none or it cannot be read."""
    try:
        data = json.loads(layout.state_file.read_text("utf-8"))
        names = {entry.name for entry in fields(SetupState)}
        return SetupState(**{name: value for name, value in data.items() if name in names})
    except (OSError, ValueError, AttributeError):
        return SetupState()


def save(layout: Layout, state: SetupState) -> None:
    """Write the stamp in one move, so that a kill leaves the old or the new one."""
    layout.notes.mkdir(parents=True, exist_ok=True)
    new = layout.state_file.with_suffix(".new")
    new.write_text(json.dumps(asdict(state), indent=1), "utf-8")
    os.replace(new, layout.state_file)
