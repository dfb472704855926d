"""Writer of the recorder's snapshots, on a thread of its own."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from spool_stream.errors import InputError

from .snapshot import Snapshot, SnapshotKeeper


class Log(Protocol):
    """Log for people."""

    def info(self, message: str) -> object:
        """Say what was done."""

    def error(self, message: str) -> object:
        """Say what went wrong."""


class SnapshotWriter:
    """Writer of what ``keeper`` has complete into ``folder``, one after the other, on a thread of its own.

    Attributes:
        written: bags that were made.

    """

    def __init__(self, keeper: SnapshotKeeper, folder: Path, log: Log) -> None:
        self.keeper = keeper
        self.written = 0
        self._folder, self._log = folder, log
        self._worker = ThreadPoolExecutor(1, "snapshots")
        self._told = False

    def watch(self, now: int, limit: int) -> None:
        """Write what is complete at ``now`` (ns), as long as the folder holds less than ``limit`` bags."""
        for snapshot in self.keeper.due(now):
            self._worker.submit(self._write, snapshot, limit)

    def close(self) -> None:
        """Write what waits, complete or not, and wait until it is written."""
        for snapshot in self.keeper.rest():
            self._worker.submit(self._write, snapshot, None)
        self._worker.shutdown()

    def _write(self, snapshot: Snapshot, limit: int | None) -> None:
        try:
            if (
                limit is not None
                and self._folder.is_dir()
                and sum(1 for _ in self._folder.iterdir()) >= limit
            ):
                if not self._told:
                    self._log.error(
                        f"{self._folder} holds {limit} snapshots (snapshot_limit): no more are made, "
                        "remove some"
                    )
                self._told = True
                return
            path = snapshot.write(self._folder)
        except (OSError, InputError) as error:
            self._log.error(f"snapshot of {snapshot.valve} {snapshot.event}: {error}")
            return
        self.written += 1
        self._told = False
        self._log.info(f"snapshot {path}: {len(snapshot.messages)} messages around {snapshot.event}")
