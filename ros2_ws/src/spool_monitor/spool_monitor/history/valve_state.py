"""State of a valve over a restart: alarms and baselines, where a folder can be written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spool_core.errors import InputError

from spool_monitor.alarms.alarm_store import AlarmStore
from spool_monitor.monitor import Monitor

from .baseline_keeper import BaselineKeeper
from .state_file import FolderLock, StateFile

ALARMS, BASELINE, TRENDS = "alarms.json", "baseline.json", "trends.sqlite"

#: ns between two attempts to write what could not be written; a full disk is not emptied within seconds.
RETRY = 10_000_000_000


@dataclass(slots=True)
class ValveState:
    """State of one valve's ``monitor``: its alarms and baselines, kept in ``folder`` (``None``: not at all).

    ``warn`` is called with one line for people. A folder that can't be written is warned of once; the monitor
    goes on without it, and :meth:`retry` writes what is due as soon as that is possible again.
    """

    monitor: Monitor
    folder: Path | None
    warn: Callable[[str], None]
    alarms: AlarmStore = field(default_factory=AlarmStore)
    baseline: BaselineKeeper = field(init=False)
    _files: dict[str, StateFile] = field(default_factory=dict, init=False)
    _lock: FolderLock | None = field(default=None, init=False)
    _due: set[str] = field(default_factory=set, init=False)
    _trouble: str = field(default="", init=False)
    _tried: int | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.baseline = BaselineKeeper(self.monitor.detection)

    @property
    def owned(self) -> bool:
        """Whether the folder is this monitor's to write in."""
        return self._lock is not None

    @property
    def writable(self) -> bool:
        """Whether what is kept is on the disk."""
        return self.owned and not self._due

    def open(self) -> None:
        """Take up what was kept; never raises for what it finds."""
        if self.folder is not None:
            self._files = {name: StateFile(self.folder / name) for name in (ALARMS, BASELINE)}
            self._take_lock()
            self._read(ALARMS, self.alarms.load)
            self._read(BASELINE, self.baseline.load)
        self.alarms.expect(self.monitor.conditions)
        self.alarms.restore(self.monitor.conditions)

    def keep_alarms(self) -> None:
        """Bring the alarms to the disk; they are there when this returns, or due."""
        self._write(ALARMS)

    def keep_baseline(self) -> None:
        """Bring the baselines to the disk, or leave them due."""
        self._write(BASELINE)

    def retry(self, now: int) -> None:
        """Say what time it is (ns): what could not be written is tried again now and then."""
        if self.folder is None or self.writable:
            return
        if self._tried is not None and 0 <= now - self._tried < RETRY:
            return
        self._tried = now
        if not self.owned and self._take_lock():
            # The monitor that held the folder until now may have changed what it keeps.
            self._read(ALARMS, self.alarms.join)
            if not self.baseline.records:
                self._read(BASELINE, self.baseline.load)
            self._due |= {ALARMS, BASELINE}
        for name in sorted(self._due):
            self._write(name)

    def close(self) -> None:
        """Let others write in the folder."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _take_lock(self) -> bool:
        assert self.folder is not None
        try:
            self._lock = FolderLock(self.folder)
        except BlockingIOError:
            self._warn_once(f"state_folder: {self.folder} is in use by another monitor: nothing is kept")
        except OSError as error:
            self._say_unwritable(error)
        return self.owned

    def _read(self, name: str, take: Callable[[Any], None]) -> None:
        file = self._files[name]
        content = file.load()
        if content is not None:
            try:
                take(content)
            except InputError as error:
                file.refuse(str(error))
        for warning in file.warnings:
            self.warn(warning)

    def _write(self, name: str) -> None:
        if not self.owned:
            return
        content = self.alarms.dump() if name == ALARMS else self.baseline.dump()
        try:
            self._files[name].save(content)
        except OSError as error:
            self._due.add(name)
            self._say_unwritable(error)
            return
        self._due.discard(name)
        if self._trouble and not self._due:
            self.warn(f"state_folder: {self.folder} can be written again: alarms and baseline are kept")
            self._trouble = ""

    def _say_unwritable(self, error: OSError) -> None:
        self._warn_once(
            f"state_folder: {self.folder} can't be written ({error.strerror}): "
            "alarms, baseline and trends are lost at a restart; it is tried again every 10 s"
        )

    def _warn_once(self, text: str) -> None:
        if self._trouble != text:
            self._trouble = text
            self.warn(text)
