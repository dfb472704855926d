"""What a monitor has learned: the baseline of a parameter, and the file that holds it.

The file survives a restart, the loss of power at any moment, and another version of the suite.
"""

from __future__ import annotations

import enum
import hashlib
import json
import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from spool_core import system
from spool_core.errors import InputError
from spool_core.numbers import MEDIAN_TO_DEVIATION

#: s, estimates do not come closer; it bounds how many are kept for a start value.
SHORTEST_PERIOD = 0.1

#: Written by this version; it reads older ones. A later version that changes what a key means counts up.
FORMAT = 1

#: B; a valve's alarms and baselines take 100 kB at most: anything larger is no state.
MOST_BYTES = 16_000_000

#: Endings of the file that is being written, of the copy before and of what could not be read.
NEW, LAST, DAMAGED = "new", "last", "damaged"


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


class Found(NamedTuple):
    """State found on the disk; ``sequence`` -1: of a later version whose checksum this one can't form."""

    format: int
    sequence: int
    content: Any


@dataclass(slots=True)
class StateFile:
    """JSON with a checksum, the last good copy next to it.

    Saving writes ``NAME.new`` to the disk first, then renames the present file to ``NAME.last`` and the new
    one to ``NAME``: whatever a power loss interrupts, one whole state is there, and loading takes the newest.
    What can't be read is kept as ``NAME.damaged``. Where ``NAME`` was written in a format that is newer than
    this version's it is read as far as it is understood and left untouched: this version keeps its own state
    in ``NAME.format1``, whose content later versions take up where it is the newer one. Only the owner may
    read the files.

    Attributes:
        warnings: what was found damaged or unknown when it was loaded, one line each.
    """

    path: Path
    warnings: list[str] = field(default_factory=list, init=False)
    _target: Path = field(init=False)
    _sequence: int = field(default=0, init=False)
    _sound: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._target = self.path

    def save(self, content: Any) -> None:
        """Write ``content``, which JSON can hold, to the disk; it is there when this returns.

        Raises:
            OSError: it could not be written; the state from before is kept.
            ValueError: JSON can't hold it.

        """
        self._sequence += 1
        text = _text(content)
        head = {"format": FORMAT, "sequence": self._sequence, "sha256": _digest(self._sequence, text)}
        system.private_folder(self._target.parent)
        new = _beside(self._target, NEW)
        new.unlink(missing_ok=True)
        system.write_synced(new, f'{json.dumps(head)[:-1]}, "content": {text}}}\n', system.FILE_MODE)
        if self._target.exists():  # a damaged file must not replace the good copy
            self._target.replace(_beside(self._target, LAST if self._sound else DAMAGED))
        new.replace(self._target)
        system.sync_folder(self._target.parent)
        self._sound = True

    def load(self) -> Any | None:
        """Return the newest whole state, ``None`` where there is none; never raises for what it finds.

        Raises:
            OSError: a file that is there can't be read now, which is no damage; nothing was decided.

        """
        self.warnings.clear()
        self._target = self.path
        found = self._look(self.path)
        newer = max((one.format for one in found.values()), default=0)
        if newer > FORMAT:
            self._target = _beside(self.path, f"format{FORMAT}")
            self.warnings.append(
                f"{self.path}: a later version of the suite wrote it (format {newer}, this version writes "
                f"{FORMAT}): it is read as far as possible and left as it is; {self._target.name} is written"
            )
        # Versions with formats up to this one's kept these while a later one's was there.
        pattern = re.compile(re.escape(self.path.name) + r"\.format(\d+)")
        try:
            names = os.listdir(self.path.parent)
        except OSError:  # not there, or not to be listed: what can't be read was looked for above
            names = []
        numbers = [match[1] for match in map(pattern.fullmatch, names) if match]
        for number in sorted(numbers):
            if int(number) <= FORMAT:
                found |= self._look(_beside(self.path, f"format{number}"))
        self._sound = self._target in found
        newest = max(found, key=lambda path: found[path].sequence, default=None)
        if newest is None or found[newest].sequence < 0:
            return None
        self._sequence = found[newest].sequence
        if any("damaged" in warning for warning in self.warnings):
            self.warnings[-1] += f"; {newest.name} is used"
        return found[newest].content

    def refuse(self, reason: str) -> None:
        """Take note that what :meth:`load` gave can't be used: saving keeps it as ``NAME.damaged``."""
        kept = f"; it will be kept as {_beside(self._target, DAMAGED).name}" if self._sound else ""
        self.warnings.append(f"{self._target}: {reason}{kept}")
        self._sound = False

    def _look(self, path: Path) -> dict[Path, Found]:
        """Return the whole states of ``path`` and of the copies next to it; what is damaged is warned of."""
        found = {}
        for one in (path, _beside(path, NEW), _beside(path, LAST)):
            try:
                found[one] = _read(one)
            except (FileNotFoundError, NotADirectoryError):
                continue
            except ValueError as error:
                if one != _beside(path, NEW):  # half a new one is what a power loss leaves
                    self.warnings.append(f"{one}: damaged: {error}")
        return found


class FolderLock:
    """Lock of a folder: sole right to write in it, held until it is released or the process ends.

    Raises:
        OSError: the folder can't be made or written, or another process holds it (BlockingIOError).

    """

    def __init__(self, folder: Path) -> None:
        system.private_folder(folder)
        descriptor = os.open(folder / "lock", os.O_WRONLY | os.O_CREAT | system.OPEN_FLAGS, system.FILE_MODE)
        self._stream = os.fdopen(descriptor, "w", encoding="utf-8")
        for path in folder.iterdir():  # of versions that left them readable to others
            if path.is_file() and not path.is_symlink():
                system.restrict(path, system.FILE_MODE)
        try:
            system.lock_file(self._stream.fileno(), wait=False)
        except OSError:
            self._stream.close()
            raise

    def release(self) -> None:
        """Let others write."""
        self._stream.close()


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


def _read(path: Path) -> Found:
    """Return the state in ``path``.

    Raises:
        OSError: it can't be read.
        ValueError: it holds no whole state; the reason is given.

    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES // 1_000_000} MB")
    try:
        whole = json.loads(path.read_text(encoding="utf-8"))
        text = _text(whole["content"]) if isinstance(whole, dict) and "content" in whole else ""
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(whole, dict) or not {"format", "sequence", "sha256", "content"} <= set(whole):
        raise ValueError("it is not a state file")
    written, sequence = whole["format"], whole["sequence"]
    if type(written) is not int or written < 1:
        raise ValueError(f"its format is {written!r}, not a whole number from 1")
    if type(sequence) is not int or whole["sha256"] != _digest(sequence, text):
        if written > FORMAT:
            return Found(written, -1, None)
        raise ValueError("its checksum does not fit")
    return Found(written, sequence, whole["content"])


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(f"{path.name}.{ending}")


def _text(content: Any) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _digest(sequence: int, text: str) -> str:
    return hashlib.sha256(f"{sequence}\n{text}".encode()).hexdigest()
