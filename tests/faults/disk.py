"""Disk and clock that fail on command: the shim, and its commands."""

from __future__ import annotations

import functools
import mmap
import struct
import subprocess
import tempfile
from pathlib import Path

NONE, FULL, BROKEN, READ_ONLY = range(4)
_CONTROL = struct.Struct("<iiiiqqqq")


@functools.cache
def shim() -> Path:
    """Compile the shim once a process and return it."""
    target = Path(tempfile.mkdtemp(prefix="spool_faults_")) / "shim.so"
    source = Path(__file__).with_name("shim.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", target, source, "-ldl", "-lpthread"], check=True)
    return target


class Disk:
    """Disk under ``folder``, healthy until told otherwise, of processes in its ``environment``."""

    def __init__(self, folder: Path, control: Path, log: Path | None = None) -> None:
        if not control.exists():
            control.write_bytes(bytes(_CONTROL.size))
        with control.open("r+b") as stream:
            self._map = mmap.mmap(stream.fileno(), _CONTROL.size)
        self.environment = {
            "LD_PRELOAD": str(shim()),
            "SPOOL_FAULTS_PREFIX": str(folder),
            "SPOOL_FAULTS_CONTROL": str(control),
        }
        if log is not None:
            self.environment["SPOOL_FAULTS_LOG"] = str(log)

    def tell(
        self, mode: int = NONE, *, sync_delay: float = 0.0, write_delay: float = 0.0, clock: float = 0.0
    ) -> None:
        """Let the disk behave like that from now on; times in s."""
        delays = round(sync_delay * 1e3), round(write_delay * 1e3)
        self._map[:] = _CONTROL.pack(mode, *delays, 0, round(clock * 1e9), 0, 0, 0)

    def fail(self, first: int, last: int, mode: int = BROKEN) -> None:
        """Let calls fail from number ``first`` to ``last``, counted from now on."""
        self._map[:] = _CONTROL.pack(mode, 0, 0, 0, 0, first, last, 0)

    @property
    def calls(self) -> int:
        """Calls that changed or opened a file since the last command."""
        return int(_CONTROL.unpack(self._map)[-1])

    def close(self) -> None:
        """Forget the control."""
        self._map.close()
