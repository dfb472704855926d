"""Event kinds, and the condition that raises and clears an event."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from spool_core.events.event import Event, EventState, Facts, Namur, Severity, Urgency, urgency_of
from spool_core.events.sentences import title
from spool_core.uncertainty import Quantity

__all__ = [
    "EACH_CHANNEL",
    "Condition", "Event", "EventCause", "EventKind", "EventState", "Facts", "Finding", "Namur", "Severity",
    "condition_name", "sensor_fault",
]  # fmt: skip

#: Parts of a fault that each channel has by itself.
EACH_CHANNEL = ("body", "spool")

#: Facts, or what makes them: most of what is judged never becomes an event.
FactsSource = Facts | Callable[[], Facts]


@dataclass(frozen=True, slots=True)
class EventCause:
    """Cause of an event and its number. A ``namur`` that is unknown is that of the kind.

    ``open``: it names several until one of them is known, which is reported then. The texts of the number are
    in :mod:`spool_core.events`.
    """

    name: str
    code: int
    namur: Namur = Namur.UNKNOWN
    open: bool = False


@dataclass(frozen=True, slots=True)
class EventKind:
    """What its events mean to a plant and to an operator.

    A number (``code``) once given never changes its meaning. ``latching``: its alarms stay until somebody
    resets them, since the machine must not forget them by itself. ``task`` is the one of ``/diagnostics``
    that shows its detectors. Files that share a kind declare it with the causes that they find.
    """

    name: str
    code: int
    namur: Namur
    latching: bool = False
    task: str = "condition"
    causes: tuple[EventCause, ...] = ()

    def cause(self, name: str) -> EventCause:
        """Return the cause called ``name``; one that is not listed is the kind as a whole."""
        whole = EventCause(name, self.code, self.namur)
        listed = next((one for one in self.causes if one.name == name), whole)
        return replace(listed, namur=listed.namur or whole.namur)


def sensor_fault(cause: EventCause) -> EventKind:
    """Return the kind of sensor faults with ``cause``: several files declare theirs."""
    return EventKind("sensor_fault", 600, Namur.FAILURE, latching=True, task="data", causes=(cause,))


def condition_name(kind: str, source: str) -> str:
    """Return the name of a condition of a valve, e.g. ``friction_drift/coulomb_force``."""
    return f"{kind}/{source}" if source else kind


class Finding(NamedTuple):
    """Finding of a detector at ``stamp`` (ns); the condition's delays come on top.

    ``indicated`` is ``None`` where nothing is wrong; between ``indicated`` and ``released`` nothing changes.
    ``hurries``: the limit of an alarm is reached before a planned stop. ``eased``: it is below the deadband
    of an alarm's limit, as ``released`` is for a warning's. ``part``: which of the detector's faults this is.
    ``side``: direction (1, -1) of a change whose directions are different faults, else 0.
    """

    stamp: int
    indicated: Severity | None
    released: bool
    cause: str
    quantity: Quantity
    facts: FactsSource = Facts()
    hurries: bool = False
    eased: bool = False
    part: str = ""
    side: int = 0


@dataclass(slots=True)
class Condition:
    """Condition with delays and a deadband: turns a wavering indication into one event on and one event off.

    It is raised when the indication held for ``on_delay`` s, cleared when the release held for
    ``off_delay`` s; between both (the deadband) nothing changes. A higher severity is reported when it held
    for ``on_delay`` s as well, so one look makes no alarm of a warning (ISA-18.2: on-delay of each limit). An
    alarm that has eased for ``off_delay`` s is a warning again, which is reported as well.
    What is indicated again within ``off_delay`` s is the same event, with its first time. A change in the
    other direction is another fault: it ends the event, and has its own on-delay. One that ``stays`` is not
    over before somebody has ``acknowledged`` it.
    """

    declared: EventKind
    on_delay: float
    off_delay: float
    source: str = ""
    stays: bool = False
    acknowledged: bool = field(default=False, init=False)
    active: Severity | None = field(default=None, init=False)
    cause: str = field(default="", init=False)
    _since: int | None = field(default=None, init=False)
    _eased: int | None = field(default=None, init=False)
    _above: dict[Severity, int] = field(default_factory=dict, init=False)
    _indicated: int | None = field(default=None, init=False)
    _raised: int | None = field(default=None, init=False)
    _last: Facts = field(default=Facts(), init=False)

    def judge(self, finding: Finding) -> list[Event]:
        """Return the event that follows, if any; where the stamp goes back, the delay starts again."""
        stamp, indicated = finding.stamp, finding.indicated
        if self.active is not None and indicated is not None and finding.side * self._last.change < 0.0:
            return self.clear(stamp, finding.quantity, finding.facts)
        # The highest severity that has been indicated for the on-delay, at least, without a break.
        for severity in (Severity.WARNING, Severity.ALARM):
            if indicated is None or severity > indicated:
                self._above.pop(severity, None)
            elif stamp < self._above.setdefault(severity, stamp):
                self._above[severity] = stamp
        least = round(self.on_delay * 1e9)
        held = max((one for one, since in self._above.items() if stamp - since >= least), default=None)
        settled = self.declared.cause(self.cause).open and not self.declared.cause(finding.cause).open
        if held is not None and (self.active is None or held > self.active or settled):
            self._indicated, self._since = self._indicated or min(self._above.values()), None
            return self._raise(finding, held)
        if self.active is not Severity.ALARM or indicated is Severity.ALARM or not finding.eased:
            self._eased = None
        elif self._eased is None or stamp < self._eased:
            self._eased = stamp
        if self.active is None or indicated is not None or not finding.released or self.holds:
            self._since = None
        elif self._since is None or stamp < self._since:
            self._since = stamp
        delay = round(self.off_delay * 1e9)
        if self._since is not None and stamp - self._since >= delay:
            return self.clear(stamp, finding.quantity, finding.facts)
        if self._eased is not None and stamp - self._eased >= delay:
            self._eased = None
            return self._raise(finding._replace(cause=finding.cause or self.cause), Severity.WARNING)
        return []

    @property
    def holds(self) -> bool:
        """Whether it is active until somebody acknowledges it."""
        return self.stays and self.active is not None and not self.acknowledged

    @property
    def ends(self) -> int | None:
        """When it is over if nothing is indicated any more, ns; ``None`` while it is not released."""
        return None if self._since is None else self._since + round(self.off_delay * 1e9)

    def clear(self, stamp: int, quantity: Quantity, facts: FactsSource = Facts()) -> list[Event]:
        """End the condition where it is active; ``facts`` are those of now.

        Where they name no parameter, what was judged before is named as unknown.
        """
        if self.active is None:
            return []
        # Causes, certainty and outlook belonged to what is over.
        now = _facts(facts)
        if not now.parameter:
            now = replace(
                self._last,
                value=math.nan,
                low=math.nan,
                high=math.nan,
                change=math.nan,
                note=now.note,
                evidence=now.evidence,
            )
        now = replace(
            now,
            began=self._raised or 0,
            causes=(),
            probabilities=(),
            false_alarm_interval=math.nan,
            time_to_limit=math.nan,
            urgency=Urgency.NONE,
            advice=0,
        )
        event = self._event(stamp, EventState.CLEARED, quantity, now)
        self.active, self.cause = None, ""
        self._above.clear()
        self._since = self._eased = self._indicated = self._raised = None
        return [event]

    def pause(self, nanoseconds: int) -> None:
        """Skip a time in which there was nothing to judge: it is no part of a delay."""
        self._since = None if self._since is None else self._since + nanoseconds
        self._eased = None if self._eased is None else self._eased + nanoseconds
        self._above = {severity: since + nanoseconds for severity, since in self._above.items()}

    def _raise(self, finding: Finding, severity: Severity) -> list[Event]:
        stamp, cause = finding.stamp, finding.cause
        self.acknowledged = self.acknowledged and self.active is not None
        self.active, self.cause = severity, cause
        self._raised = stamp if self._raised is None else self._raised
        facts, declared = _facts(finding.facts), self.declared.cause(cause)
        facts = replace(
            facts,
            began=facts.began or self._indicated or 0,
            urgency=urgency_of(declared.namur, severity, hurries=finding.hurries),
            advice=declared.code,
        )
        self._last = facts
        return [self._event(stamp, EventState.RAISED, finding.quantity, facts)]

    @property
    def kind(self) -> str:
        """Name of its events' kind."""
        return self.declared.name

    @property
    def name(self) -> str:
        """Name that distinguishes it from the valve's others, e.g. ``friction_drift/coulomb_force``."""
        return condition_name(self.kind, self.source)

    @property
    def title(self) -> str:
        """Title of its events while it is active, in English, e.g. ``Friction drift (wear)``."""
        own, subject = title(self.declared.cause(self.cause).code, self.kind), self._last.subject
        return f"{own} ({subject})" if subject in EACH_CHANNEL else own

    def restore(self, severity: Severity, cause: str, facts: Facts = Facts()) -> None:
        """Go on as active, as it was before a restart; no event follows. ``facts``: of the last event."""
        self.active, self.cause, self._last = severity, cause, facts
        self._above.clear()
        self._since = self._eased = self._indicated = self._raised = None

    def _event(self, stamp: int, state: EventState, quantity: Quantity, facts: Facts) -> Event:
        assert self.active is not None
        code = self.declared.cause(self.cause).code
        return Event(stamp, self.kind, state, self.active, self.cause, quantity, self.source, code, facts)


def _facts(source: FactsSource) -> Facts:
    return source() if callable(source) else source
