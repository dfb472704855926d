"""What a monitor has learned: the baseline of a parameter, and what holds it over a loss of power."""

from __future__ import annotations

import enum
import hashlib
import json
import math
import os
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from spool_core import system
from spool_core.errors import InputError
from spool_core.numbers import MEDIAN_TO_DEVIATION

from spool_monitor.state_database import FILE, PATIENCE, VERSION, StateDatabase, named, opened, put_aside

#: s, estimates do not come closer; it bounds how many are kept for a start value.
SHORTEST_PERIOD = 0.1

#: Name of the copy of alarms and baselines next to the file.
LAST = f"{FILE}.last"


@dataclass(frozen=True, slots=True)
class HealthyValue:
    """Start value of one parameter of the healthy valve, in ``unit``, as it is kept.

    ``value`` is what is compared with (the median), ``spread`` the robust standard deviation around it;
    ``mean`` and ``standard_deviation`` are those of the ``count`` valid estimates. ``correlation`` is that of
    neighbouring ones (NaN: not determined), without which no false-alarm rate can be stated. ``referred``
    says that it holds at one oil temperature; at ``temperature`` (deg C, NaN: not measured) it was learned.
    ``sensitivity`` is that to a gain error between the accelerometers then (NaN: not known).
    """

    name: str
    unit: str
    value: float
    spread: float
    mean: float
    standard_deviation: float
    count: int
    correlation: float = math.nan
    referred: bool = False
    temperature: float = math.nan
    sensitivity: float = math.nan


@dataclass(slots=True)
class Baseline:
    """Baseline of one parameter: its start value, the median of the valid estimates of ``duration`` s,
    three at least.

    Each estimate counts for the shortest time between two, so that standstills do not count. ``value`` and
    ``spread`` (robust standard deviation) are NaN while it is being learned, and so are ``mean`` and
    ``deviation`` of the ``count`` estimates and ``correlation``, that of neighbours.
    """

    duration: float
    value: float = field(default=math.nan, init=False)
    spread: float = field(default=math.nan, init=False)
    mean: float = field(default=math.nan, init=False)
    deviation: float = field(default=math.nan, init=False)
    correlation: float = field(default=math.nan, init=False)
    count: int = field(default=0, init=False)
    _seen: list[float] = field(default_factory=list, init=False)
    _last: int | None = field(default=None, init=False)
    _period: float = field(default=math.inf, init=False)

    @property
    def frozen(self) -> bool:
        """Whether the start value is fixed."""
        return not math.isnan(self.value)

    def learn(self, stamp: int, value: float) -> None:
        """Take the estimate at ``stamp`` (ns) in, until there are enough of them."""
        if self.frozen:
            return
        if self._last is not None and stamp > self._last:
            self._period = min(self._period, max(SHORTEST_PERIOD, (stamp - self._last) * 1e-9))
        self._last = stamp
        self._seen.append(value)
        # Half a period less: stamps jitter.
        if len(self._seen) >= 3 and (len(self._seen) + 0.5) * self._period >= self.duration:
            self.value = float(np.median(self._seen))
            self.spread = MEDIAN_TO_DEVIATION * float(np.median(np.abs(np.array(self._seen) - self.value)))
            seen = np.array(self._seen)
            self.count, self.mean, self.deviation = seen.size, float(seen.mean()), float(seen.std(ddof=1))
            around = seen - self.mean
            power = float(around @ around)
            self.correlation = float(around[1:] @ around[:-1]) / power if power > 0.0 else math.nan
            self._seen.clear()

    def restart(self) -> None:
        """Learn from here on; a fixed start value is forgotten."""
        self.value = self.spread = self.mean = self.deviation = self.correlation = math.nan
        self.count = 0
        self._seen.clear()

    def restore(self, kept: HealthyValue) -> None:
        """Go on with a start value that was learned before."""
        self.restart()
        self.value, self.spread = kept.value, kept.spread
        self.mean, self.deviation, self.correlation = (kept.mean, kept.standard_deviation, kept.correlation)
        self.count = kept.count


class BaselineStage(enum.Enum):
    """Stage of a baseline: how far it has come."""

    LEARNED = "learned"  # complete and used, but nobody has confirmed it
    FROZEN = "frozen"  # confirmed: replaced by a newer version only


@dataclass(frozen=True, slots=True)
class BaselineRecord:
    """Baseline of a valve, complete.

    ``valve_id`` and ``oil`` (empty: not known) name what it was learned on, ``temperature`` the lowest and
    highest oil temperature met meanwhile (deg C, NaN: not measured), ``learned_at`` when (ns).
    ``who`` and ``comment`` are of the operator who froze it.
    """

    valve_id: str
    oil: str = ""
    temperature: tuple[float, float] = (math.nan, math.nan)
    version: int = 0
    stage: BaselineStage = BaselineStage.LEARNED
    learned_at: int = 0
    who: str = ""
    comment: str = ""
    values: tuple[HealthyValue, ...] = field(default=())

    def value(self, name: str) -> HealthyValue | None:
        """Return a parameter by its name, ``None`` where it was not learned."""
        return next((value for value in self.values if value.name == name), None)

    def check_valve(self, valve_id: str, oil: str) -> None:
        """Make sure that this is the baseline of that valve with that oil.

        Raises:
            InputError: it is another's; both are named. An unknown oil (empty) fits every one.

        """
        if valve_id != self.valve_id:
            raise InputError(
                f"baseline version {self.version} is of valve {self.valve_id}, not of {valve_id}: "
                "name that valve's state_folder, or learn again"
            )
        if oil and self.oil and oil != self.oil:
            raise InputError(
                f"baseline version {self.version} of {valve_id} was learned with {self.oil}, "
                f"the valve runs on {oil}: learn again"
            )


class StateTable(StateDatabase):
    """Alarms and baselines, each as JSON with its checksum, in one valve's file or in the copy next to it."""

    SCHEMA = "CREATE TABLE IF NOT EXISTS state (name TEXT PRIMARY KEY, whole BLOB NOT NULL)"
    READS_LATER = True

    def write(self, name: str, whole: bytes) -> None:
        """Replace the state ``name`` with ``whole``; errors as of :class:`StateDatabase`."""
        self.check_file()
        with named(self.path), self.base:
            self.base.execute("INSERT OR REPLACE INTO state VALUES (?, ?)", (name, whole))

    def read(self) -> dict[str, bytes]:
        """Return what is kept by name; errors as of :class:`StateDatabase`."""
        if not self.ask("SELECT 1 FROM sqlite_master WHERE name = 'state'", (int,)):
            return {}  # written by a version that kept it elsewhere
        return dict(self.ask("SELECT name, whole FROM state", (str, bytes)))


@dataclass(slots=True)
class StateFile:
    """Alarms and baselines of one valve in its ``folder``: in the file of its trends and in a copy of them.

    Each saving is a transaction of the file, then one of the copy (:data:`LAST`): whatever a power loss
    interrupts, one whole state is there, and loading takes the newest. What can't be read is kept as
    ``NAME.damaged``. A file of a later version is read as far as it is understood and left untouched, see
    :func:`.state_database.own_file`. Where there is none, the JSON of earlier versions is taken up.
    ``warn`` is called with one line for people about what is damaged or unknown.
    """

    folder: Path
    warn: Callable[[str], None]
    patience: float = PATIENCE
    _sequences: dict[str, int] = field(default_factory=dict, init=False)
    _refused: dict[str, bytes] = field(default_factory=dict, init=False)
    _open: dict[str, StateTable] = field(default_factory=dict, init=False)

    def save(self, name: str, content: Any) -> None:
        """Write ``content``, which JSON can hold, to the disk; it is there when this returns.

        Raises:
            InputError: the file was damaged while it was in use; the next saving begins a new one.
            OSError: it could not be written to the file, or not to the copy.
            ValueError: JSON can't hold it; the state from before is kept.

        """
        sequence = self._sequences[name] = self._sequences.get(name, 0) + 1
        whole = {"sequence": sequence, "sha256": _digest(sequence, content), "content": content}
        if name in self._refused:
            system.write_durably(self.folder / f"{name}.damaged", self._refused[name], mode=system.FILE_MODE)
            del self._refused[name]
        failed: InputError | OSError | None = None
        for file in (FILE, LAST):
            try:
                if file not in self._open:
                    self._open[file] = opened(StateTable, self.folder / file, self.warn, self.patience)
                self._open[file].write(name, json.dumps(whole).encode())
            except (InputError, OSError) as error:
                failed = failed or error
                table = self._open.pop(file, None)
                if table is not None:
                    table.close()
                    if isinstance(error, InputError):
                        with suppress(OSError):
                            put_aside(table.path, error, self.warn)
        if failed is not None:
            raise failed

    def load(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the newest whole state of each of ``names`` that has one.

        Raises:
            OSError: a file that is there can't be read now, which is no damage; nothing was decided.

        """
        loaded, said, tables = {}, list[str](), {}
        files = self.folder.glob("trends*.sqlite*")  # of other versions, too
        for path in sorted(one for one in files if one.suffix in (".sqlite", ".last")):
            try:
                with closing(StateTable(path, read_only=True, patience=self.patience)) as table:
                    tables[path.name] = table.read()
            except InputError as error:
                said.append(str(error))
                continue
            if table.version > VERSION:
                said.append(
                    f"a later version of the suite wrote {path.name} (format {table.version}, this version "
                    f"writes {VERSION}): it is read as far as possible and left as it is"
                )
        for name in names:
            kept = _newest({file: table[name] for file, table in tables.items() if name in table}, said)
            self._sequences[name] = kept["sequence"] if kept else 0
            if not kept:
                earlier = {path.name: path.read_bytes() for path in self.folder.glob(f"{name}.json*")}
                kept = _newest(earlier, said)
            if kept:
                loaded[name] = kept["content"]
        for line in said:
            self.warn(f"{self.folder}: {line}")
        return loaded

    def refuse(self, name: str, content: Any, reason: str) -> None:
        """Warn that what :meth:`load` gave can't be used; saving keeps it as ``NAME.damaged``."""
        self.warn(f"{self.folder}: {reason}; it will be kept as {name}.damaged")
        self._refused[name] = json.dumps(content).encode()

    def close(self) -> None:
        """Close the files."""
        while self._open:
            self._open.popitem()[1].close()


def lock_folder(folder: Path) -> TextIO:
    """Take the sole right to write in a folder, until the returned file is closed or the process ends.

    Raises:
        OSError: the folder can't be made or written, or another process holds it (BlockingIOError).

    """
    system.private_folder(folder)
    descriptor = os.open(folder / "lock", os.O_WRONLY | os.O_CREAT | system.OPEN_FLAGS, system.FILE_MODE)
    lock = os.fdopen(descriptor, "w", encoding="utf-8")
    for path in folder.iterdir():  # of versions that left them readable to others
        if path.is_file() and not path.is_symlink():
            system.restrict(path, system.FILE_MODE)
    try:
        system.lock_file(lock.fileno(), wait=False)
    except OSError:
        lock.close()
        raise
    return lock


def default_folder() -> Path:
    """Return where the suite keeps state: ``$XDG_STATE_HOME/spool``, else ``~/.local/state/spool``.

    Raises:
        RuntimeError: there is neither and no home either.

    """
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".local" / "state") / "spool"


def valve_folder(base: Path, namespace: str) -> Path:
    """Return the folder of the valve in ``namespace`` (``/press/left``) below ``base``."""
    return base.joinpath(*(part for part in namespace.split("/") if part not in ("", ".", ".."))) / "monitor"


def _newest(found: dict[str, bytes], said: list[str]) -> dict[str, Any] | None:
    """Return the newest whole state of ``found``, by file; what is damaged is ``said``."""
    states = []
    for file, data in found.items():
        try:
            whole = json.loads(data)
            sequence = whole["sequence"]
            if type(sequence) is not int or whole["sha256"] != _digest(sequence, whole["content"]):
                raise ValueError("its checksum does not fit")
            states.append(whole)
        except (KeyError, RecursionError, TypeError, ValueError) as error:
            if not file.endswith((".new", ".damaged")):  # half a new one is what a power loss leaves
                said.append(f"{file}: damaged: {error}")
    return max(states, key=lambda whole: whole["sequence"], default=None)


def _digest(sequence: int, content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(f"{sequence}\n{text}".encode()).hexdigest()
