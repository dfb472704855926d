"""Events: their kinds, one event, and the condition that raises and clears it."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from spool_core.text import Account, duration, over, raised, urgency
from spool_core.uncertainty import Quantity

#: What there is to tell, or what makes it: most of what is judged is never told. A string is what is seen.
Told = str | Account
Text = Told | Callable[[], Told]

#: What is said of the time to a limit where nothing is followed over time.
NO_TREND = "no trend tells a time"


class Namur(enum.IntEnum):
    """Status signal after NAMUR NE 107, a worse one above; numbers as in ``spool_msgs/msg/ValveHealth``."""

    UNKNOWN = 0
    NORMAL = 1
    MAINTENANCE_REQUIRED = 2  # M: works, but its reserve is running out
    OUT_OF_SPECIFICATION = 3  # S: is operated outside of what it was made for
    FUNCTION_CHECK = 4  # C: for now not valid, somebody works on it or it learns
    FAILURE = 5  # F: the signal is not valid

    @property
    def letter(self) -> str:
        """The letter that people know the status by; empty where all is well or nothing is known."""
        return {5: "F", 4: "C", 3: "S", 2: "M"}.get(int(self), "")


@dataclass(frozen=True, slots=True)
class EventCause:
    """Cause of an event: its number, what it means on the machine, and what to do.

    What is left empty, and ``namur`` where it is unknown, is as for the kind as a whole.
    """

    name: str
    code: int
    meaning: str = ""
    remedy: str = ""
    namur: Namur = Namur.UNKNOWN


@dataclass(frozen=True, slots=True)
class EventKind:
    """Event kind: what its events mean to a plant and to an operator.

    A number (``code``) once given never changes its meaning. ``latching``: its alarms stay until somebody
    resets them, since the machine must not forget them by itself. ``task`` is the one of ``/diagnostics``
    that shows its detectors. Files that share a kind declare it with the causes that they find.
    """

    name: str
    code: int
    namur: Namur
    meaning: str = ""
    remedy: str = ""
    latching: bool = False
    task: str = "condition"
    causes: tuple[EventCause, ...] = ()

    def cause(self, name: str) -> EventCause:
        """Return the cause called ``name``; one that is not listed is the kind as a whole."""
        whole = EventCause(name, self.code, self.meaning, self.remedy, self.namur)
        listed = next((one for one in self.causes if one.name == name), whole)
        return replace(
            listed,
            meaning=listed.meaning or whole.meaning,
            remedy=listed.remedy or whole.remedy,
            namur=listed.namur or whole.namur,
        )


class EventState(enum.IntEnum):
    """State of an event; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    RAISED = 1
    CLEARED = 2


class Severity(enum.IntEnum):
    """Severity of an event; the numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    WARNING = 1
    ALARM = 2


def condition_name(kind: str, source: str) -> str:
    """Return the name of a condition of a valve, e.g. ``friction_drift/coulomb_force``."""
    return f"{kind}/{source}" if source else kind


@dataclass(frozen=True, slots=True)
class Event:
    """Event that began or ended at ``stamp`` (ns, acquisition time).

    ``source`` says which one of a kind's conditions it is, e.g. ``coulomb_force``; empty where there is one.
    """

    stamp: int
    kind: str
    state: EventState
    severity: Severity
    cause: str
    quantity: Quantity
    message: str
    source: str = ""


class Finding(NamedTuple):
    """Finding of a detector at ``stamp`` (ns); the condition's delays come on top.

    ``indicated`` is ``None`` where nothing is wrong; between ``indicated`` and ``released`` nothing changes.
    """

    stamp: int
    indicated: Severity | None
    released: bool
    cause: str
    quantity: Quantity
    message: Text


@dataclass(slots=True)
class Condition:
    """Condition with delays and a deadband: turns a wavering indication into one event on and one event off.

    It is raised when the indication held for ``on_delay`` s, cleared when the release held for
    ``off_delay`` s; between both (the deadband) nothing changes. A higher severity is reported immediately.
    """

    declared: EventKind
    on_delay: float
    off_delay: float
    source: str = ""
    active: Severity | None = field(default=None, init=False)
    cause: str = field(default="", init=False)
    _since: int | None = field(default=None, init=False)
    _indicated: int | None = field(default=None, init=False)
    _raised: int | None = field(default=None, init=False)

    def judge(self, finding: Finding) -> list[Event]:
        """Return the event that follows, if any; where the stamp goes back, the delay starts anew."""
        stamp, indicated = finding.stamp, finding.indicated
        wanted = indicated is not None if self.active is None else finding.released
        if self.active is not None and indicated is not None:
            self._since = None
            if indicated > self.active:
                return self._raise(finding, indicated)
            return []
        if not wanted:
            self._since = None
            return []
        if self._since is None or stamp < self._since:
            self._since = stamp
        if stamp - self._since < round((self.on_delay if self.active is None else self.off_delay) * 1e9):
            return []
        if self.active is None:
            assert indicated is not None
            self._indicated = self._since
            self._since = None
            return self._raise(finding, indicated)
        return self.clear(stamp, finding.quantity, finding.message)

    def clear(self, stamp: int, quantity: Quantity, message: Text) -> list[Event]:
        """End the condition where it is active; ``message`` says what is seen now."""
        if self.active is None:
            return []
        # A clock that was set back makes no time negative.
        began = self._raised if self._raised is not None and self._raised <= stamp else None
        lasted = math.nan if began is None else 1e-9 * (stamp - began)
        text = over(self.kind, _account(message), lasted)
        event = self._event(stamp, EventState.CLEARED, quantity, text)
        self.active, self.cause = None, ""
        self._since = self._indicated = self._raised = None
        return [event]

    def _raise(self, finding: Finding, severity: Severity) -> list[Event]:
        stamp, cause = finding.stamp, finding.cause
        self.active, self.cause = severity, cause
        self._raised = stamp if self._raised is None else self._raised
        account = _account(finding.message)
        if math.isnan(account.began) and self._indicated is not None:
            account = replace(account, began=1e-9 * (stamp - self._indicated))
        declared = self.declared.cause(cause)
        account = replace(
            account,
            sure=account.sure or self._sure(),
            urgent=account.urgent
            or urgency(declared.namur.letter, alarm=severity is Severity.ALARM, hurries=account.hurries),
            outlook=account.outlook or NO_TREND,
        )
        text = raised(account, declared.remedy)
        return [self._event(stamp, EventState.RAISED, finding.quantity, text)]

    def _sure(self) -> str:
        """Return what speaks for a finding that states no error of its own."""
        if self.on_delay > 0.0:
            return f"seen without a break for {duration(self.on_delay)} or more"
        return "counted, not estimated"

    @property
    def kind(self) -> str:
        """Name of its events' kind."""
        return self.declared.name

    @property
    def name(self) -> str:
        """Name that distinguishes it from the valve's others, e.g. ``friction_drift/coulomb_force``."""
        return condition_name(self.kind, self.source)

    def restore(self, severity: Severity, cause: str) -> None:
        """Go on as active, as it was before a restart; no event follows."""
        self.active, self.cause = severity, cause
        self._since = self._indicated = self._raised = None

    def _event(self, stamp: int, state: EventState, quantity: Quantity, message: str) -> Event:
        assert self.active is not None
        return Event(stamp, self.kind, state, self.active, self.cause, quantity, message, self.source)


def _account(text: Text) -> Account:
    told = text() if callable(text) else text
    return Account(told) if isinstance(told, str) else told
