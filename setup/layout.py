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


@dataclass(frozen=True)
class Layout:
    """The folders and files that the set-up works on.

    Attributes:
        root: the repository.
        underlay: the ROS 2 beneath; each has its own environment and build.
    """

    root: Path
    underlay: Underlay

    @property
    def notes(self) -> Path:
        """Folder of the stamp and the logs."""
        return self.root / ".setup" / f"on_{self.underlay.name}"

    @property
    def state_file(self) -> Path:
        """What has been set up, as JSON."""
        return self.notes / "state.json"

    @property
    def lock_file(self) -> Path:
        """Held while something is being set up."""
        return self.notes / "busy.lock"

    @property
    def venv(self) -> Path:
        """The Python environment."""
        return self.root / ".venv" if self.underlay.is_wheels else self.notes / "venv"

    @property
    def python(self) -> Path:
        """The environment's interpreter."""
        return self.venv / "bin" / "python"

    @property
    def ready_file(self) -> Path:
        """Tells the launcher that this environment's interpreter is complete."""
        return self.venv / "spool-ready"

    @property
    def workspace(self) -> Path:
        """The ROS 2 workspace."""
        return self.root / "ros2_ws"

    @property
    def output(self) -> Path:
        """Folder that holds build, install and log."""
        return self.workspace if self.underlay.is_wheels else self.notes

    @property
    def install(self) -> Path:
        """The built workspace."""
        return self.output / "install"

    @property
    def requirements(self) -> Path:
        """The lock: every package with its version and hashes."""
        return self.root / "requirements" / ("wheels.lock" if self.underlay.is_wheels else "sourced.lock")

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
