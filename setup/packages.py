"""Locked packages of the environment: installed, resumed, compared with the lock."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from setup import uv
from setup.layout import Layout, SetupError
from setup.process import Runner, ask
from setup.requirements import PYTHON

PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)(?: ; (.*?))? ?\\?$")
VERSION_BOUND = re.compile(r"python_full_version (<|>=|==) '3\.(\d+)(?:\.\*)?'")
NO_NETWORK = re.compile(
    "NewConnectionError|ConnectTimeout|ConnectionError|ProxyError|NameResolutionError|ReadTimeout"
    "|Network is unreachable"
    "|Temporary failure in name resolution|Connection (refused|broken|reset)|Cannot connect to proxy"
)


def locked(lock: Path) -> dict[str, str]:
    """Names and versions that a lock holds for this Python."""
    minor = sys.version_info[1]
    tests = {"<": minor.__lt__, ">=": minor.__ge__, "==": minor.__eq__}
    found = {}
    for line in lock.read_text().splitlines():
        if match := PIN.match(line):
            # Conditions on the Python version; the locks know no others on Linux.
            bounds = VERSION_BOUND.findall(match[3] or "")
            if all(tests[operator](int(bound)) for operator, bound in bounds):
                found[_normal(match[1])] = match[2]
    return found


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def site_packages(layout: Layout) -> Path | None:
    """The environment's site-packages, None where it has none."""
    return next(iter((layout.venv / "lib").glob("python3.*/site-packages")), None)


def installed(folders: Iterable[Path]) -> dict[str, str]:
    """Names and versions of the packages in the folders given."""
    from importlib.metadata import distributions  # noqa: PLC0415  (a call that finds all set up needs none)

    entries = distributions(path=[str(folder) for folder in folders])
    return {_normal(entry.metadata["Name"]): entry.version for entry in entries if entry.metadata["Name"]}


def make_venv(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Make the environment again.

    Raises:
        SetupError: it could not be made.
    """
    if layout.venv.is_symlink():
        layout.venv.unlink()
    elif layout.venv.exists():
        shutil.rmtree(layout.venv)
    log = runner.log("venv")
    options = [] if layout.underlay.is_wheels else ["--system-site-packages"]
    command: list[str | Path] = [PYTHON, "-m", "venv", *options, layout.venv]
    code, output = runner.run("venv", command, environment)
    if code != 0:
        if "ensurepip" in output and "No space left" not in output:
            raise SetupError(
                f"{PYTHON} cannot make a virtual environment: "
                f"Debian, Ubuntu: apt install python3-venv; see {log}"
            )
        raise failure("the environment could not be made", output, log)


def venv_works(layout: Layout, environment: Mapping[str, str]) -> bool:
    """Whether the environment's interpreter and pip run."""
    try:
        return ask([layout.python, "-I", "-c", "import pip._internal"], environment).returncode == 0
    except OSError:
        return False


def forget_half_installed(layout: Layout) -> None:
    """Remove what a killed installer left, so that the next one does not take it for installed."""
    folder = site_packages(layout)
    for entry in folder.iterdir() if folder else ():
        # pip and uv write INSTALLER after the last file of a package.
        half = entry.name.endswith(".dist-info") and not (entry / "INSTALLER").exists()
        if entry.is_dir() and (half or entry.name.startswith("~")):
            shutil.rmtree(entry)


def install(layout: Layout, environment: Mapping[str, str], runner: Runner) -> None:
    """Install the lock with uv, or with pip where uv fails; what is there in the right version stays.

    Raises:
        SetupError: names the cause: no network, a wrong hash, a full disk, or the log.
    """
    if uv.install(layout, environment, runner):
        return
    command: list[str | Path] = [layout.python, "-m", "pip", "install", "-r", layout.requirements]
    command += ["--no-deps", "--require-hashes", "--retries", "1", "--timeout", "20", "--progress-bar", "off"]
    command += ["--disable-pip-version-check", "--no-input", "--no-warn-script-location"]
    code, output = runner.run("install", command, environment)
    if code != 0:
        raise failure("the packages could not be installed", output, runner.log("install"))


def failure(what: str, output: str, log: Path) -> SetupError:
    """The line for a tool that failed, by the causes that users can do something about."""
    if "No space left on device" in output or "Disk quota exceeded" in output:
        return SetupError(
            f"{what}: the disk that holds {log.parent.parent.parent} or {_temporary()} is full: "
            "free some space and call again"
        )
    if "DO NOT MATCH THE HASHES" in output.upper():
        package = re.search(r"^ {4}(\S+) from ", output, re.MULTILINE)
        name = package[1] if package else "a package"
        return SetupError(
            f"{what}: {name} is not the file that the lock was made with: "
            f"empty pip's cache (pip cache purge) or ask who runs your package index; see {log}"
        )
    if NO_NETWORK.search(output):
        return SetupError(
            f"{what}: no connection to the package index: "
            f"check network and proxy, then call again to go on; see {log}"
        )
    errors = [line[7:] for line in output.splitlines() if line.startswith("ERROR: ")]
    if errors and "No matching distribution" in errors[-1]:
        return SetupError(
            f"{what}: {errors[-1].lower()} on your package index: check pip's configuration; see {log}"
        )
    return SetupError(f"{what}: {errors[-1] if errors else 'the tool failed'}; see {log}")


def _temporary() -> str:
    return os.environ.get("TMPDIR", "/tmp")
