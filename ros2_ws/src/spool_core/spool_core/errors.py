"""Errors that become one line for the user: wrong input, a missing library, what the system refuses."""

from __future__ import annotations

import shlex
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: First release that has what the suite imports, where distributions still ship older ones: Debian 12 and
#: Ubuntu 24.04 have pydantic 1.10, typer 0.7 and 0.9, textual 0.1 and 0.52.
OLDEST = {"pydantic": "2.0", "typer": "0.29"}
#: Import names whose package has another one.
PACKAGES = {"yaml": "PyYAML", "nptdms": "npTDMS"}
#: Libraries of ROS 2 besides messages, which no package registry has under these names.
ROS = ("rclpy", "ament_index_python", "launch", "launch_ros")
#: Packages of ros2_ws/addons, which an installation may lack.
ADD_ONS = ("spool_design", "spool_fleet", "spool_opcua", "spool_rigs")


class InputError(ValueError):
    """Input or usage is wrong; the message says in one line what, where and what to do.

    The command line prints it as it is and exits with 2; a node refuses the transition.
    """


def add_on_missing(name: str) -> str:
    """Return the line for what the missing add-on ``name`` does."""
    return f"this is in the add-on {name}: put its folder into ros2_ws/addons and call again"


def operator_missing(given_by: str = "'who'") -> str:
    """Return the line for an act of nobody; ``given_by``: the field or option that names the operator."""
    return f"{given_by} is required: name the operator"


@contextmanager
def libraries_reported(program: str) -> Iterator[None]:
    """Turn the failed import of a library into one line on standard error and exit code 2.

    Args:
        program: name for the line.

    Raises:
        SystemExit: a library is missing or too old.
        ImportError: a module of the suite itself cannot be imported.
    """
    try:
        yield
    except ImportError as error:
        said = unmet_library(error)
        if said is None:
            raise
        print(f"{program}: {said}", file=sys.stderr, flush=True)
        raise SystemExit(2) from None


def refused_by_system(error: OSError) -> str:
    """Return the line for what the operating system refused: the path, and its reason."""
    if error.filename:
        return f"{error.filename}: {error.strerror}"
    return f"{error.strerror or error}{removed_folder()}"


def removed_folder() -> str:
    """Return what to add to a message where the working folder is gone, else an empty text."""
    try:
        Path.cwd()
    except OSError:
        return "; the working folder was removed: change to another one (cd)"
    return ""


def unmet_library(error: ImportError) -> str | None:
    """Return which library or add-on an import failed for and what to do; ``None`` for another own module."""
    if error.name in ADD_ONS:
        return add_on_missing(error.name)
    name = (error.name or "").partition(".")[0]
    if name in ROS or name.endswith(("_msgs", "_interfaces")):
        return f"this needs ROS 2 ({name} is missing): use ./spool in a checkout, or source a ROS 2"
    if not name or name.startswith("spool_") or name in sys.stdlib_module_names:
        return None
    import importlib.metadata  # noqa: PLC0415 - with zipfile and email, where a library is missing only

    package = PACKAGES.get(name, name)
    wanted = f"{package}>={OLDEST[name]}" if name in OLDEST else package
    try:
        found = importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return f"the Python package {wanted} is missing: {how_to_install(wanted)}"
    if name in OLDEST and _release(found) < _release(OLDEST[name]):
        return f"{package} {found} is too old, {wanted} is needed: {how_to_install(wanted)}"
    return f"{package} {found} cannot be used ({error}): {how_to_install(f'--upgrade {package}')}"


def how_to_install(wanted: str) -> str:
    """Return what to type for the package ``wanted``, with options of pip before it.

    A Python that the system manages takes packages in a virtual environment only (PEP 668).
    """
    managed = Path(sysconfig.get_path("stdlib"), "EXTERNALLY-MANAGED").exists()
    if managed and sys.prefix == sys.base_prefix:
        return "build in a virtual environment, see 'Installation on a ROS 2' in spool_bringup/README.md"
    words = [sys.executable, "-m", "pip", "install", *wanted.split()]
    return f"type {' '.join(map(shlex.quote, words))}"


def _release(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:2] if part.isdigit())
