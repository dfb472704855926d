"""The set-up: what is missing is done, step by step, each step remembered."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from door import mend, packages, state, workspace
from door.errors import DoorError
from door.fingerprint import cmake_dependents, package_fingerprints
from door.interpreter import inspect, require_tools, this_interpreter
from door.layout import Layout
from door.process import ask, run_logged
from door.state import State
from door.steps import Steps, say

NEEDED_BYTES = 2_000_000_000
WARM_UP = "spool_estimator.warm_up"


def is_current(layout: Layout, done: State, running_series: str) -> bool:
    """Whether nothing has to be done.

    Args:
        layout: the project.
        done: the stamp.
        running_series: "3.x" of the interpreter that the launcher chose.
    """
    return (
        _stale(layout, done, running_series) is None
        and layout.ready_file.exists()
        and bool(done.environment)
        and done.packages == package_fingerprints(layout.workspace / "src")
        and (layout.install / "local_setup.bash").exists()
    )


def ensure(layout: Layout, environment: Mapping[str, str], running_series: str) -> State:
    """Do what is missing of the set-up.

    Returns:
        The stamp, complete.

    Raises:
        DoorError: one line that says what went wrong.
    """
    try:
        layout.notes.mkdir(parents=True, exist_ok=True)
        with _alone(layout) as keep_open:
            done = state.load(layout)
            if not is_current(layout, done, running_series):
                _set_up(layout, environment, running_series, done, keep_open)
            return done
    except OSError as error:
        raise _cannot_write(layout, error) from error


def _set_up(
    layout: Layout, environment: Mapping[str, str], running_series: str, done: State, keep_open: int
) -> None:
    """All steps that are missing; updates and saves `done` after each."""
    stale = _stale(layout, done, running_series)
    began_before = done.base_python != ""
    if stale is not None and began_before:
        say(f"{stale}: setting up anew")
    base = inspect(this_interpreter(), environment)
    if (
        base.executable
        and done.base_python
        and os.environ.get("SPOOL_PYTHON", "") == ""
        and os.access(done.base_python, os.X_OK)
    ):
        base = inspect(done.base_python, environment)
    require_tools(base, layout.underlay.is_wheels, environment.get("PATH"))
    if not layout.underlay.is_wheels:
        _require_ros(layout, base.executable, environment)
    tools = workspace.base_environment(layout, environment)
    fresh = stale is not None or not packages.venv_works(layout, tools)
    if fresh:
        _require_space(layout)
        done.__dict__.update(State(root=str(layout.root), base_python=base.executable).__dict__)
    wanted = package_fingerprints(layout.workspace / "src")
    warm = (
        not done.warmed
        and (layout.workspace / "src" / "spool_estimator" / (WARM_UP.replace(".", "/") + ".py")).exists()
    )
    install = not done.lock
    build = (
        install
        or done.packages != wanted
        or not done.environment
        or not (layout.install / "local_setup.bash").exists()
    )
    steps = Steps(fresh + install + (not done.mended and layout.underlay.is_wheels) + build + warm)

    if fresh:
        state.save(layout, State())
        with steps.step(
            f"making {layout.venv.relative_to(layout.root)} with Python {'.'.join(map(str, base.version))}"
        ):
            packages.make_venv(layout, base.executable, tools, keep_open)
        done.python_version = base.series
        done.underlay = list(layout.underlay.prefixes)
        state.save(layout, done)
    if install:
        layout.ready_file.unlink(missing_ok=True)
        packages.forget_half_installed(layout)
        lock = layout.lock_hash()
        with steps.step(f"installing {len(packages.locked(layout.requirements, base.series))} packages"):
            packages.install(layout, tools, keep_open, steps)
        done.lock = lock
        state.save(layout, done)
    tools = workspace.base_environment(layout, environment)
    if layout.underlay.is_wheels and not done.mended:
        with steps.step("mending the CMake files of the ROS 2 wheels"):
            mend.mend(layout, tools)
        done.mended = True
        workspace.remove_built(layout)
        done.packages = {}
        state.save(layout, done)
    if build:
        _build(layout, done, wanted, tools, keep_open, steps)
    if warm:
        with steps.step("compiling the numerical kernels"):
            _warm_up(layout, done, environment, keep_open, steps)
        done.warmed = True
        state.save(layout, done)
    layout.ready_file.touch()
    steps.total()


def _build(
    layout: Layout,
    done: State,
    wanted: dict[str, str],
    tools: Mapping[str, str],
    keep_open: int,
    steps: Steps,
) -> None:
    """Build the packages that changed, and learn the environment anew."""
    if not (layout.install / "local_setup.bash").exists():
        done.packages = {}
    if not done.packages:
        workspace.remove_built(layout)
    changed = {name for name, value in wanted.items() if done.packages.get(name) != value}
    for gone in done.packages.keys() - wanted.keys():
        workspace.remove_built(layout, gone)
    names = sorted(cmake_dependents(layout.workspace / "src", changed))
    what = (
        f"{len(names)} packages" if len(names) > 1 else (names[0] if names else "nothing, a package is gone")
    )
    with steps.step(f"building {what}"):
        if names:
            environment = (
                tools if not done.environment else {**tools, **done.environment, "PATH": tools["PATH"]}
            )
            workspace.build(layout, environment, keep_open, steps, names)
        done.environment = workspace.learn_environment(layout, tools)
    done.packages = wanted
    state.save(layout, done)


def _warm_up(
    layout: Layout, done: State, environment: Mapping[str, str], keep_open: int, steps: Steps
) -> None:
    """Compile the kernels into their cache on disk."""
    log = layout.notes / "kernels.log"
    run = workspace.run_environment(layout, done, environment)
    code, output = run_logged([layout.python, "-m", WARM_UP], log, run, keep_open, steps.progress)
    if code != 0:
        raise packages.failure("the kernels could not be compiled", output, log)


def _stale(layout: Layout, done: State, running_series: str) -> str | None:
    """Why the environment has to be made anew, None where it need not."""
    if not done.python_version:
        return "the set-up had hardly begun"
    if done.root != str(layout.root):
        return f"the project was moved from {done.root}"
    if done.underlay != list(layout.underlay.prefixes):
        return f"ROS 2 {layout.underlay.name} lies in other folders than before"
    if done.python_version != running_series:
        return f"Python changed from {done.python_version} to {running_series}"
    if not os.access(layout.python, os.X_OK):
        return f"{layout.python} is gone"
    if done.lock and done.lock != layout.lock_hash():
        return f"{layout.requirements.relative_to(layout.root)} changed"
    return None


@contextmanager
def _alone(layout: Layout) -> Iterator[int]:
    """Hold the set-up's lock; wait, and say so, where another one holds it."""
    with layout.lock_file.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"another set-up is at work in {layout.root}: waiting for it")
            fcntl.flock(file, fcntl.LOCK_EX)
        yield file.fileno()


def _require_ros(layout: Layout, python: str, environment: Mapping[str, str]) -> None:
    """Check that the sourced ROS 2 is really there and speaks with this Python."""
    name = layout.underlay.name
    if not any(os.path.isdir(prefix) for prefix in layout.underlay.prefixes):
        raise DoorError(
            f"ROS_DISTRO={name} is set but AMENT_PREFIX_PATH names no folder that exists: "
            f"source /opt/ros/{name}/setup.bash, or unset ROS_DISTRO to use the wheels"
        )
    if ask([python, "-c", "import rclpy"], environment).returncode != 0:
        raise DoorError(
            f"ROS 2 {name} is sourced but {python} cannot import rclpy: "
            "name the Python that this ROS 2 was built for in SPOOL_PYTHON, e.g. /usr/bin/python3"
        )


def _require_space(layout: Layout) -> None:
    """Refuse to begin on a disk that will be full before the end."""
    free = shutil.disk_usage(layout.root).free
    if layout.venv.exists():
        return
    if free < NEEDED_BYTES:
        raise DoorError(
            f"{layout.root} has {free / 1e9:.1f} GB free, the set-up takes {NEEDED_BYTES / 1e9:.0f} GB: free some space and call again"
        )


def _cannot_write(layout: Layout, error: OSError) -> DoorError:
    """The line for a folder that cannot be written."""
    where = error.filename or layout.root
    if error.errno == errno.ENOSPC:
        return DoorError(f"the disk that holds {where} is full: free some space and call again")
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return DoorError(
            f"{where} cannot be written, and something has to be set up there: "
            "make the folder writable, or copy the project to one that is"
        )
    return DoorError(f"{where}: {error.strerror}")
