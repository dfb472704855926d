"""Nodes as processes: their executables found, one that replaces this process, several started and ended."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from spool_core.errors import InputError
from spool_core.text import did_you_mean

from spool_tools.command import GONE


def find_executable(package: str, executable: str) -> Path:
    """Return ``lib/PACKAGE/EXECUTABLE`` of the first prefix that has it.

    Raises:
        InputError: package or executable is not installed; what there is is named.
    """
    prefixes = [
        Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
    ]
    owners = [
        prefix
        for prefix in prefixes
        if (prefix / "share/ament_index/resource_index/packages" / package).exists()
    ]
    if not owners:
        index = (prefix / "share/ament_index/resource_index/packages" for prefix in prefixes)
        near = did_you_mean(package, (found.name for folder in index for found in folder.glob("*")))
        hint = near or "; is the workspace built and sourced?"
        raise InputError(f"package {package} is not installed{hint}")
    for prefix in owners:
        folder = prefix / "lib" / package
        if os.access(folder / executable, os.X_OK):
            return folder / executable
    if (package, executable) == ("spool_view", "plots"):
        raise InputError(f"{executable}: {GONE[executable]}")
    found = sorted(path.name for path in (owners[0] / "lib" / package).glob("*") if os.access(path, os.X_OK))
    raise InputError(
        f"package {package} has no executable {executable}; it has: {', '.join(found) or 'none'}"
        f"{did_you_mean(executable, found)}"
    )


def replace_by_node(package: str, executable: str, arguments: Sequence[str]) -> None:
    """Become the node: same process, so that signals and exit code are its own."""
    path = find_executable(package, executable)
    os.execv(path, [str(path), *arguments])


@dataclass(slots=True)
class Nodes:
    """Node processes; leaving the context ends all that still run.

    ``log`` takes what they print.
    """

    log: Path
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, name: str, package: str, executable: str, arguments: Sequence[str] = ()) -> None:
        """Start a node in its own session, so that Ctrl-C reaches it through :meth:`stop` only."""
        with self.log.open("ab") as output:
            self.running[name] = subprocess.Popen(
                [str(find_executable(package, executable)), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def dead(self) -> list[str]:
        """Return the names of those that ended by themselves."""
        return [name for name, process in self.running.items() if process.poll() is not None]

    def stop(self, *names: str, patience: float = 10.0) -> None:
        """End the named ones with SIGINT together; kill what does not end in ``patience`` s."""
        chosen = [self.running.pop(name) for name in names if name in self.running]
        for process in chosen:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in chosen:
            try:
                process.wait(timeout=patience)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(*self.running)
