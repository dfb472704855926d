"""Writer of the recorder's snapshots, on a thread of its own."""

from __future__ import annotations

import re
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from spool_core.errors import InputError
from spool_core.system import remove

from spool_bag.mcap.part_chain import begin_of

from .snapshot import Snapshot, SnapshotKeeper

#: Name of a snapshot: valve, event and time, and a number where the name was taken.
_NAME = re.compile(r".+_\w+_\d{8}T\d{6}Z(_\d+)?")
#: Snapshots that wait for the disk, each of them as large as its valve's rings.
MOST_KEPT = 4


class Log(Protocol):
    """Log for people."""

    def info(self, message: str) -> object:
        """Say what was done."""

    def error(self, message: str) -> object:
        """Say what went wrong."""


class SnapshotWriter:
    """Writer of what ``keeper`` has complete into ``folder``, one after the other, on a thread of its own.

    With a ``quota`` (B) the oldest snapshots go before the folder holds more than that. What the disk refuses
    is tried again, at most :data:`MOST_KEPT` snapshots.

    Attributes:
        written: bags that were made.

    """

    def __init__(self, keeper: SnapshotKeeper, folder: Path, log: Log, quota: int = 0) -> None:
        self.keeper = keeper
        self.written = 0
        self._folder, self._log = folder, log
        self._worker = ThreadPoolExecutor(1, "snapshots")
        self._told = False
        self._quota = quota
        self._failed: deque[Snapshot] = deque(maxlen=MOST_KEPT)
        self._pending: Future[None] | None = None

    def watch(self, now: int, limit: int) -> None:
        """Write what is complete at ``now`` (ns); of more than ``limit`` bags in the folder the oldest go."""
        again = [self._failed.popleft()] if self._failed and self._worker_is_idle else []
        for snapshot in (*again, *self.keeper.due(now)):
            self._pending = self._worker.submit(self._write, snapshot, limit)

    @property
    def _worker_is_idle(self) -> bool:
        return self._pending is None or self._pending.done()

    def close(self) -> None:
        """Write what waits, complete or not, and wait until it is written."""
        for snapshot in (*self._failed, *self.keeper.rest()):
            self._worker.submit(self._write, snapshot, None)
        self._worker.shutdown()

    def _write(self, snapshot: Snapshot, limit: int | None) -> None:
        try:
            self._make_room(snapshot.bytes, limit)
            path = snapshot.write(self._folder)
        except (OSError, InputError) as error:
            if not self._told:
                self._log.error(f"snapshot of {snapshot.valve} {snapshot.event}: {error}; it is tried again")
            self._told = True
            self._failed.append(snapshot)
            return
        self.written += 1
        self._told = False
        self._log.info(f"snapshot {path}: {len(snapshot.messages)} messages around {snapshot.event}")

    def _make_room(self, size: int, limit: int | None) -> None:
        """Remove the oldest snapshots until one of ``size`` B fits into quota and ``limit``."""
        if not self._folder.is_dir():
            return
        bags = sorted(filter(_is_snapshot, self._folder.iterdir()), key=lambda bag: bag.stat().st_mtime)
        sizes = [sum(file.stat().st_size for file in bag.iterdir() if file.is_file()) for bag in bags]
        held, left = sum(sizes), len(bags)
        for bag, own in zip(bags, sizes, strict=True):
            large = self._quota and held + size > self._quota
            if not large and (limit is None or left < limit):
                break
            remove(bag)
            held, left = held - own, left - 1
            because = "snapshot_max_total_size" if large else "snapshot_limit"
            self._log.info(f"snapshot {bag} is removed: {because}")


def _is_snapshot(bag: Path) -> bool:
    """Return whether a folder is a snapshot: one bag in one file; a recording in parts never goes for one."""
    if not (_NAME.fullmatch(bag.name) and bag.is_dir() and not bag.is_symlink()):
        return False
    files = list(bag.glob("*.mcap"))
    return len(files) == 1 and files[0].name == f"{bag.name}_0.mcap" and begin_of(files[0]) is None
