"""`./spool doctor`: what is wrong with this machine or installation, and what to do."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from importlib.metadata import distributions

from spool_tools.operations.machine_findings import Finding, machine_findings, print_findings

from setup import packages, requirements, workspace
from setup.layout import Layout, SetupError
from setup.process import ask
from setup.requirements import SetupState

IMPORTS = "import rclpy, spool_msgs.msg as m; m.AccelerationBlock()"
HELP = """Usage: ./spool doctor [--live [--seconds S]]

Checks machine and installation; each line is ok, warning or problem, with what to do.
With --live it also listens to the running nodes and reports which resources are short.
Exit code 1 if there is a problem.
Example: ./spool doctor --live --seconds 10
"""


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
    return print_findings(_examine(layout, done, environment))


def _examine(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[Finding]:
    try:
        requirements.check_machine(layout, environment)
        yield Finding("ok", f"Python {requirements.VERSION} at {requirements.PYTHON}, with headers")
        yield Finding("ok", "compiler and make")
    except SetupError as error:
        # What is built already runs without a compiler.
        yield Finding(
            "warning" if done.built and requirements.missing_tools(environment.get("PATH")) else "problem",
            str(error),
        )
    free = shutil.disk_usage(layout.root).free
    enough = bool(done.lock) or free >= requirements.NEEDED_BYTES
    advice = "" if enough else f": the set-up takes {requirements.NEEDED_BYTES / 1e9:.0f} GB, free some space"
    yield Finding("ok" if enough else "problem", f"disk: {free / 1e9:.1f} GB free at {layout.root}{advice}")
    yield from machine_findings(environment, wheels=layout.underlay.is_wheels)
    yield from _installation(layout, done, environment)


def _installation(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[Finding]:
    yield Finding("ok", f"uses {layout.underlay}")
    try:
        requirements.check_ros(layout, environment)
    except SetupError as error:
        yield Finding("problem", str(error))
        return
    if not done.python_version:
        yield Finding("warning", "not set up yet: ./spool demo does it")
        return
    reason = requirements.stale(layout, done)
    if reason:
        yield Finding("warning", f"{reason}: the next call sets up again")
        return
    if not done.lock:
        yield Finding("warning", "the set-up is not finished: the next call continues it")
        return
    yield from _packages(layout)
    if not done.built:
        yield Finding("warning", "the workspace is not built yet: the next call does it")
        return
    yield from _workspace(layout, done, environment)


def _packages(layout: Layout) -> Iterator[Finding]:
    folder = packages.site_packages(layout)
    found = packages.installed([folder] if folder else [])
    wanted = packages.locked(layout.requirements)
    wrong = [f"{name} {found.get(name, 'missing')} for {version}" for name, version in wanted.items()
             if found.get(name) != version]  # fmt: skip
    if wrong and layout.underlay.is_wheels:
        shown = ", ".join(wrong[:3]) + (f" and {len(wrong) - 3} more" if len(wrong) > 3 else "")
        yield Finding(
            "problem",
            f"{layout.venv} differs from the lock ({shown}): delete {layout.venv} and call ./spool demo",
        )
    else:
        yield Finding("ok", f"{len(wanted)} packages match {layout.requirements.relative_to(layout.root)}")
    if layout.underlay.is_wheels:
        foreign = workspace.foreign_files(layout)
        yield Finding(
            "problem" if foreign else "ok",
            f"{len(foreign)} CMake files contain paths of another machine: delete {layout.venv}, call again"
            if foreign
            else "CMake files of the wheels contain the paths of this machine",
        )
    if "numba" not in found:
        yield Finding("warning", "numba is missing: the kernels run uncompiled, many times slower")


def _workspace(layout: Layout, done: SetupState, environment: Mapping[str, str]) -> Iterator[Finding]:
    wanted = workspace.package_fingerprints(layout.packages)
    changed = sorted(
        name for name in wanted.keys() | done.built.keys() if wanted.get(name) != done.built.get(name)
    )
    if changed:
        yield Finding("warning", f"{', '.join(changed)} changed since the last build: the next call builds")
    else:
        yield Finding("ok", f"{len(wanted)} packages of the workspace built and up to date")
    answer = ask([layout.python, "-c", IMPORTS], workspace.run_environment(layout, environment))
    if answer.returncode:
        reason = (answer.stderr.strip().splitlines() or ["no message"])[-1]
        yield Finding(
            "problem",
            f"rclpy and spool_msgs cannot be imported ({reason}): delete {layout.install} and call again",
        )
    else:
        yield Finding("ok", "rclpy and spool_msgs can be imported")
    missing = [
        f"{one.name}/{entry.name}"
        for one in distributions(path=[str(workspace.modules(layout))])
        for entry in one.entry_points.select(group="console_scripts")
        if not os.access(layout.install / "lib" / one.name / entry.name, os.X_OK)
    ]
    if missing:
        yield Finding(
            "problem", f"{', '.join(missing)} missing in {layout.install}: delete that folder and call again"
        )
    else:
        yield Finding("ok", "the nodes' executables are installed")
