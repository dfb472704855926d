"""State of a valve that outlives the process: baselines, alarms, counts."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TextIO

from pydantic import TypeAdapter, ValidationError
from spool_core.errors import InputError
from spool_core.events.sentences import headline
from spool_estimator.estimate import Estimate, State

from spool_monitor.alarm import Alarm, AlarmRefusedError, Input, Operator, Transition
from spool_monitor.alarm_store import AlarmStore, serialised
from spool_monitor.detection import Detection
from spool_monitor.journal import DAYS, Journal, JournalEntry
from spool_monitor.monitor import Monitor
from spool_monitor.state_database import FILE, opened
from spool_monitor.state_file import (
    Baseline,
    BaselineRecord,
    BaselineStage,
    HealthyValue,
    StateFile,
    lock_folder,
)

ALARMS, BASELINE, JOURNAL = "alarms", "baseline", "the journal"

#: Entries of the journal that are held at most while they can't be written.
MOST_HELD = 10_000

#: s that an alarm waits for a program that holds the journal's file, chosen short; then the entry is held.
PATIENCE = 1.0

#: ns between two attempts to write what could not be written; a full disk is not emptied within seconds.
RETRY = 10_000_000_000

#: Versions that are kept.
KEPT = 10

_RECORDS = TypeAdapter(list[BaselineRecord])
_NOT_MEASURED = (math.nan, math.nan)


@dataclass(slots=True)
class ValveState:
    """State of one valve's ``monitor``: its alarms and baselines, kept in ``folder`` (``None``: not at all).

    ``warn`` is called with one line for people. A folder that can't be written or read is warned of once; the
    monitor goes on without it, and :meth:`retry` writes what is due as soon as that is possible again. A file
    that could not be read is not replaced before it was.
    """

    monitor: Monitor
    folder: Path | None
    warn: Callable[[str], None]
    alarms: AlarmStore = field(default_factory=AlarmStore)
    journal_days: float = DAYS
    baseline: BaselineKeeper = field(init=False)
    _file: StateFile = field(init=False)
    _lock: TextIO | None = field(default=None, init=False)
    _due: set[str] = field(default_factory=set, init=False)
    _unread: set[str] = field(default_factory=set, init=False)
    _held: deque[JournalEntry] = field(default_factory=lambda: deque(maxlen=MOST_HELD), init=False)
    _unsure: int = field(default=0, init=False)
    _journal: Journal | None = field(default=None, init=False)
    _trouble: set[str] = field(default_factory=set, init=False)
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
        self.alarms.expect(self.monitor.conditions)
        if self.folder is not None:
            self._file = StateFile(self.folder, self.warn, PATIENCE)
            self._take_lock()
            self._unread = {ALARMS, BASELINE}
            self._read()
        self.alarms.restore(self.monitor.conditions)

    def keep_alarms(self) -> None:
        """Bring the alarms to the disk; they are there when this returns, or due."""
        self._write(ALARMS)

    def note(self, entries: Iterable[JournalEntry]) -> None:
        """Bring ``entries`` to the journal; they are on the disk when this returns, or due."""
        if self.folder is None:
            return
        self._held.extend(entries)
        if self._held:
            self._write(JOURNAL)

    def keep_baseline(self) -> None:
        """Bring the baselines to the disk, or leave them due."""
        self._write(BASELINE)

    def retry(self, now: int) -> bool:
        """Say what time it is (ns): what could not be written or read is tried again now and then.

        Returns:
            Whether alarms of before were taken up now.

        """
        if self.folder is None or self.writable:
            return False
        if self._tried is not None and 0 <= now - self._tried < RETRY:
            return False
        self._tried = now
        if not self.owned and self._take_lock():
            # The monitor that held the folder until now may have changed what it keeps.
            self._unread |= {ALARMS} if self.baseline.records else {ALARMS, BASELINE}
            self._due |= {ALARMS, BASELINE}
        unread = ALARMS in self._unread
        for name in sorted(self._due):
            self._write(name)
        return unread and ALARMS not in self._unread

    def close(self) -> None:
        """Write what is due, if that is possible now, and let others write in the folder."""
        self._tried = None
        self.retry(0)
        if self._due and self.owned:
            self.warn(f"state_folder: {self.folder}: not written and lost: {', '.join(sorted(self._due))}")
        self._close_journal()
        if self.folder is not None:
            self._file.close()
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _take_lock(self) -> bool:
        assert self.folder is not None
        try:
            self._lock = lock_folder(self.folder)
        except BlockingIOError:
            self._warn_once(f"state_folder: {self.folder} is in use by another monitor: nothing is kept")
        except OSError as error:
            self._say_unwritable(error)
        return self.owned

    def _read(self) -> bool:
        """Take up what the file holds, if that was not done yet; return whether it may be written now."""
        if not self._unread:
            return True
        try:
            found = self._file.load(self._unread)
        except OSError as error:
            self._due |= self._unread
            self._warn_once(
                f"state_folder: {self.folder} can't be read ({error.strerror or error}): alarms and baseline "
                "of before are not known; the monitor tries again every 10 s and replaces nothing"
            )
            return False
        self._unread.clear()
        for name, content in found.items():
            try:
                if name == ALARMS:
                    self.alarms.join(content)
                    self.alarms.restore(self.monitor.conditions)
                else:
                    self.baseline.load(content)
            except InputError as error:
                self._file.refuse(name, content, str(error))
        return True

    def _write(self, name: str) -> None:
        if not self.owned or not self._read():
            return
        try:
            if name == JOURNAL:
                self._write_journal()
            else:
                self._file.save(name, self.alarms.dump() if name == ALARMS else self.baseline.dump())
        except (InputError, OSError) as error:
            self._due.add(name)
            self._say_unwritable(error)
            return
        self._due.discard(name)
        if self._trouble and not self._due:
            self.warn(
                f"state_folder: {self.folder} can be written again: alarms, baseline and journal are kept"
            )
            self._trouble.clear()

    def _write_journal(self) -> None:
        """Write the entries that are held.

        Raises:
            InputError: the file is damaged.
            OSError: it can't be written.

        """
        assert self.folder is not None
        try:
            if self._journal is None:
                path, days = self.folder / FILE, self.journal_days
                self._journal = opened(Journal, path, self.warn, PATIENCE, days=days)
                # A writing that failed may be on the disk all the same.
                if self._journal.newest(self._unsure) == list(self._held)[: self._unsure]:
                    for _ in range(self._unsure):
                        self._held.popleft()
                self._unsure = 0
            self._unsure = len(self._held)
            self._journal.write(self._held)
            self._unsure = 0
        except (InputError, OSError):
            self._close_journal()
            raise
        self._held.clear()

    def _close_journal(self) -> None:
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def _say_unwritable(self, error: InputError | OSError) -> None:
        reason = getattr(error, "strerror", None) or error
        self._warn_once(
            f"state_folder: {self.folder} can't be written ({reason}): "
            "alarms, baseline, trends and journal are lost at a restart; the monitor tries again every 10 s"
        )

    def _warn_once(self, text: str) -> None:
        if text not in self._trouble:
            self._trouble.add(text)
            self.warn(text)


@dataclass(slots=True)
class BaselineKeeper:
    """Keeper of the baselines: keeps what the monitor's :class:`Detection` learned, and give it back to it.

    Nothing is taken up or kept before the valve is known (:meth:`identify`), since a baseline belongs to one
    valve and its oil.

    Attributes:
        records: the versions there are, the newest last, :data:`KEPT` at most.
        current: the one that is compared with, ``None`` while it is learned.
        anew: whether somebody asked to learn again, so that a restart goes on with that.

    """

    detection: Detection
    records: list[BaselineRecord] = field(default_factory=list, init=False)
    current: BaselineRecord | None = field(default=None, init=False)
    anew: bool = field(default=False, init=False)
    _valve: tuple[str, str] | None = field(default=None, init=False)
    _band: tuple[float, float] = field(default=_NOT_MEASURED, init=False)

    def identify(self, valve_id: str, oil: str = "") -> bool:
        """Take the newest baseline of this valve with this oil; return whether there is one.

        A description that is wrong for a while costs nothing: what was learned by the one before is kept, and
        is taken up when that returns.

        Raises:
            InputError: every baseline is another valve's or of another oil; the newest and this valve are
                named. It is not used, learning goes on.

        """
        if self._valve == (valve_id, oil):
            return False
        if self._valve is not None:
            self._start_over()
        self._valve = (valve_id, oil)
        if not self.records or self.anew:
            return False
        refused: list[InputError] = []
        for record in reversed(self.records):
            try:
                record.check_valve(valve_id, oil)
            except InputError as error:
                refused.append(error)
                continue
            self._use(record)
            return True
        raise refused[0]

    def update(self, estimate: Estimate) -> bool:
        """Learn from an estimate that the monitor has seen; return whether the state has to be saved."""
        if self.current is None and estimate.state is State.TRACKING and estimate.oil_temperature.known:
            celsius = estimate.oil_temperature.value
            low, high = self._band
            self._band = (celsius, celsius) if math.isnan(low) else (min(low, celsius), max(high, celsius))
        if self._valve is None:
            return False
        parameters, channels = self.detection.parameters.values(), self.detection.learned.values()
        learned = sum(start.frozen for start in (*(drift.baseline for drift in parameters), *channels))
        if self.current is not None and learned <= len(self.current.values):
            return False
        values = healthy_values(self.detection)
        if self.current is None:
            if not values:
                return False
            valve_id, oil = self._valve
            version = max((one.version for one in self.records), default=0) + 1
            self.current = BaselineRecord(
                valve_id, oil, self._band, version, BaselineStage.LEARNED, estimate.stamp, values=values
            )
            self.records = [*self.records, self.current][-KEPT:]
            self.anew = False
            return True
        # What takes longer to learn joins later.
        self._change(replace(self.current, values=values))
        return True

    def learn(self) -> None:
        """Forget what is compared with and learn again; the kept versions stay."""
        self.anew = True
        self._start_over()

    def freeze(self, operator: Operator) -> BaselineRecord:
        """Confirm what was learned; return it.

        Raises:
            AlarmRefusedError: nothing is learned yet, or it is frozen already.

        """
        if self.current is None:
            raise AlarmRefusedError("baseline: it is still being learned, so there is nothing to freeze")
        if self.current.stage is BaselineStage.FROZEN:
            raise AlarmRefusedError(
                f"baseline: version {self.current.version} was frozen by {self.current.who} already"
            )
        return self._change(
            replace(self.current, stage=BaselineStage.FROZEN, who=operator.who, comment=operator.comment)
        )

    def restore(self, version: int) -> BaselineRecord:
        """Compare with an older version again; return it.

        Raises:
            AlarmRefusedError: there is no such version, or the valve is not known yet.
            InputError: it is another valve's.

        """
        found = next((one for one in self.records if one.version == version), None)
        if found is None:
            there = ", ".join(str(one.version) for one in self.records) or "none"
            raise AlarmRefusedError(f"baseline: no version {version}; there are: {there}")
        if self._valve is None:
            raise AlarmRefusedError("baseline: the valve is not known yet")
        found.check_valve(*self._valve)
        # The newest is what a restart takes up.
        self.records = [*(one for one in self.records if one is not found), found]
        self.anew = False
        self._use(found)
        return found

    def dump(self) -> dict[str, Any]:
        """Return what :meth:`load` takes, as JSON can hold it."""
        records = [serialised({**asdict(one), "stage": one.stage.value}) for one in self.records]
        return {"anew": self.anew, "records": records}

    def load(self, content: Any) -> None:
        """Take up what :meth:`dump` gave; it is used once the valve is known.

        Raises:
            InputError: ``content`` is something else.

        """
        try:
            records = _RECORDS.validate_python(content["records"])
            self.records, self.anew = records[-KEPT:], bool(content["anew"])
        except (ValidationError, TypeError, KeyError) as error:
            raise InputError(f"the kept baseline can't be read: {str(error).splitlines()[0]}") from error
        if self._valve is not None:  # it was read late: what was learned meanwhile gives way to it
            valve, self._valve = self._valve, ("", "")
            with suppress(InputError):  # another valve's: this one learns on
                self.identify(*valve)

    def _use(self, record: BaselineRecord) -> None:
        self.current = record
        take_up(self.detection, record.values)

    def _change(self, record: BaselineRecord) -> BaselineRecord:
        self.records = [record if one is self.current else one for one in self.records]
        self.current = record
        return record

    def _start_over(self) -> None:
        self.current, self._band = None, _NOT_MEASURED
        self.detection.relearn()


def entries_of(transitions: Iterable[Transition], operator: Operator | None = None) -> list[JournalEntry]:
    """Return what the journal keeps of ``transitions``: all but that an event's numbers moved."""
    return [
        _entry(one.after, one.input, operator)
        for one in transitions
        if one.changed and (one.input is not Input.RAISE or one.after.occurrence != one.before.occurrence)
    ]


def healthy_values(detection: Detection) -> tuple[HealthyValue, ...]:
    """Return what was learned so far, nothing before every parameter of the model is."""
    if not all(one.baseline.frozen for one in detection.parameters.values()):
        return ()
    values = [
        replace(
            _healthy_value(detection, name, drift.baseline),
            referred=drift.referred,
            temperature=drift.temperature,
            sensitivity=drift.sensitivity,
        )
        for name, drift in detection.parameters.items()
    ]
    learned = [(name, start) for name, start in detection.learned.items() if start.frozen]
    return (*values, *(_healthy_value(detection, name, start) for name, start in learned))


def take_up(detection: Detection, values: tuple[HealthyValue, ...]) -> None:
    """Set ``values`` as the baseline of ``detection``; it learns those that are missing."""
    detection.relearn()
    for kept in values:
        drift = detection.parameters.get(kept.name)
        if drift is not None:
            drift.baseline.restore(kept)
            drift.referred, drift.temperature = kept.referred, kept.temperature
            drift.sensitivity = kept.sensitivity
        elif kept.name in detection.learned:
            detection.learned[kept.name].restore(kept)


def _healthy_value(detection: Detection, name: str, start: Baseline) -> HealthyValue:
    return HealthyValue(
        name, detection.units[name], start.value, start.spread, start.mean, start.deviation, start.count,
        start.correlation,
    )  # fmt: skip


def _entry(alarm: Alarm, action: Input, operator: Operator | None) -> JournalEntry:
    event = alarm.event
    value = event.quantity.value if event is not None else math.nan
    return JournalEntry(
        stamp=alarm.changed_at if operator is None else operator.stamp,
        action=action.value,
        alarm=alarm.name,
        code=alarm.code,
        namur=alarm.kind_namur.letter,
        severity=alarm.severity.name.lower(),
        state=alarm.state.name.lower(),
        occurrence=alarm.occurrence,
        who="" if operator is None else operator.who,
        comment="" if operator is None else operator.comment,
        text="" if event is None else event.text or headline(event),
        value=value if math.isfinite(value) else None,
        unit="" if event is None else event.quantity.unit,
        event="" if event is None else json.dumps(serialised(asdict(event))),
    )
