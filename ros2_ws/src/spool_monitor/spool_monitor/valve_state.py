"""What a monitor keeps of its valve over a restart: alarms and baselines, where a folder can be written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from spool_stream.errors import InputError

from .alarm_book import AlarmBook
from .baseline_keeper import BaselineKeeper
from .monitor import Monitor
from .state_file import FolderLock, StateFile

ALARMS, BASELINE, TRENDS = "alarms.json", "baseline.json", "trends.sqlite"


@dataclass(slots=True)
class ValveState:
    """Alarms and baselines of one valve's ``monitor``, kept in ``folder`` (``None``: not at all).

    ``warn`` is called with one line for people. A folder that can't be written is warned of once; the monitor
    goes on without it.
    """

    monitor: Monitor
    folder: Path | None
    warn: Callable[[str], None]
    alarms: AlarmBook = field(default_factory=AlarmBook)
    baseline: BaselineKeeper = field(init=False)
    _files: dict[str, StateFile] = field(default_factory=dict, init=False)
    _lock: FolderLock | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.baseline = BaselineKeeper(self.monitor.detection)

    @property
    def writable(self) -> bool:
        """Whether something is kept."""
        return self._lock is not None

    def open(self) -> None:
        """Take up what was kept; never raises for what it finds."""
        if self.folder is not None:
            try:
                self._lock = FolderLock(self.folder)
            except BlockingIOError:
                self.warn(f"state_folder: {self.folder} is in use by another monitor: nothing is kept")
            except OSError as error:
                self._give_up(error)
            self._read(ALARMS, self.alarms.load)
            self._read(BASELINE, self.baseline.load)
        self.alarms.expect(self.monitor.conditions)
        self.alarms.restore(self.monitor.conditions)

    def keep_alarms(self) -> None:
        """Bring the alarms to the disk; they are there when this returns."""
        self._write(ALARMS, self.alarms.dump())

    def keep_baseline(self) -> None:
        """Bring the baselines to the disk."""
        self._write(BASELINE, self.baseline.dump())

    def close(self) -> None:
        """Let others write in the folder."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def _read(self, name: str, take: Callable[[Any], None]) -> None:
        assert self.folder is not None
        file = self._files[name] = StateFile(self.folder / name)
        content = file.load()
        for warning in file.warnings:
            self.warn(warning)
        if content is None:
            return
        try:
            take(content)
        except InputError as error:
            self.warn(f"{file.path}: {error}")

    def _write(self, name: str, content: Any) -> None:
        if not self.writable:
            return
        try:
            self._files[name].save(content)
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.close()
        self.warn(
            f"state_folder: {self.folder} can't be written ({error.strerror}): "
            "alarms, baseline and trends are lost at a restart"
        )
