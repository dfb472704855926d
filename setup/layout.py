"""Layout of the project: where its files lie, which ROS 2 it stands on, and the error of the set-up."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

WHEELS = "wheels"


@dataclass(frozen=True)
class Underlay:
    """The ROS 2 beneath the workspace.

    Attributes:
        name: "wheels", or the name of the sourced distribution, e.g. "jazzy".
        prefixes: installation prefixes of the sourced ROS 2, in order; empty for the wheels.
    """

    name: str
    prefixes: tuple[str, ...] = ()

    @property
    def is_wheels(self) -> bool:
        """Whether ROS 2 comes from the lock's wheels."""
        return self.name == WHEELS

    def __str__(self) -> str:
        """One phrase for messages."""
        if self.is_wheels:
            return "ROS 2 Jazzy from wheels"
        return f"the sourced ROS 2 {self.name} in {', '.join(self.prefixes) or 'no prefix'}"


class Layout:
    """The folders and files that the set-up works on.

    Attributes:
        root: the repository.
        underlay: the ROS 2 beneath; each has its own environment and build.
        notes: folder of the stamp and the logs.
        venv: the Python environment, `python` its interpreter.
        workspace: the ROS 2 workspace, `packages` its packages and add-ons.
        output: folder that holds `build` and `install`, the built workspace.
        requirements: the lock, every package with its version and hashes.
    """

    def __init__(self, root: Path, underlay: Underlay) -> None:
        wheels = underlay.is_wheels
        self.root, self.underlay = root, underlay
        self.notes = root / ".setup" / f"on_{underlay.name}"
        self.state_file, self.lock_file = self.notes / "state.json", self.notes / "busy.lock"
        self.venv = root / ".venv" if wheels else self.notes / "venv"
        self.python = self.venv / "bin" / "python"
        # Tells the launcher that this environment's interpreter is complete.
        self.ready_file = self.venv / "spool-ready"
        self.workspace = root / "ros2_ws"
        self.packages = sorted(path.parent for path in self.workspace.glob("[as]*/*/package.xml"))
        self.output = self.workspace if wheels else self.notes
        self.install = self.output / "install"
        self.requirements = root / "requirements" / ("wheels.lock" if wheels else "sourced.lock")

    def lock_hash(self) -> str:
        """Fingerprint of the lock."""
        return hashlib.sha256(self.requirements.read_bytes()).hexdigest()


def find_underlay(root: Path, environment: Mapping[str, str]) -> Underlay:
    """The ROS 2 that `environment` has sourced, or the wheels where it has none."""
    name = environment.get("ROS_DISTRO", "")
    if not name:
        return Underlay(WHEELS)
    paths = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    own = str(root) + os.sep
    return Underlay(name, tuple(path for path in paths if path and not path.startswith(own)))


class SetupError(Exception):
    """Something the user can put right; the message says what, where, and what to do.

    Args:
        message: one line for stderr.
        exit_code: 2 unless told.
    """

    def __init__(self, message: str, exit_code: int = 2) -> None:
        super().__init__(message)
        self.exit_code = exit_code
