"""What begins and ends on a valve."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field

from spool_estimator.gap_watch import MODEL_GAP, GapChange
from spool_stream.quantity import Quantity

#: What people read, or what writes it: most of what is judged is never told.
Text = str | Callable[[], str]


class EventState(enum.IntEnum):
    """The numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    RAISED = 1
    CLEARED = 2


class Severity(enum.IntEnum):
    """The numbers are those of ``spool_msgs/msg/HealthEvent``."""

    UNKNOWN = 0
    WARNING = 1
    ALARM = 2


def condition_name(kind: str, source: str) -> str:
    """Return the name of a condition of a valve."""
    return f"{kind}/{source}" if source else kind


@dataclass(frozen=True, slots=True)
class Event:
    """Something began or ended at ``stamp`` (ns, acquisition time).

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


def gap_event(change: GapChange) -> Event:
    """Return the event that the estimator's node publishes for ``change``."""
    state = EventState.RAISED if change.raised else EventState.CLEARED
    return Event(change.stamp, MODEL_GAP, state, Severity.WARNING, "", change.residual, change.sentence)


@dataclass(slots=True)
class Condition:
    """Turn a wavering indication into one event on and one event off.

    It is raised when the indication held for ``on_delay`` s, cleared when the release held for
    ``off_delay`` s; between both (the deadband) nothing changes. A higher severity is reported at once.
    """

    kind: str
    on_delay: float
    off_delay: float
    source: str = ""
    active: Severity | None = field(default=None, init=False)
    cause: str = field(default="", init=False)
    _since: int | None = field(default=None, init=False)

    def judge(
        self,
        stamp: int,
        indicated: Severity | None,
        *,
        released: bool,
        cause: str,
        quantity: Quantity,
        message: Text,
    ) -> list[Event]:
        """Return the event that follows, if any; where ``stamp`` (ns) goes back, the delay starts anew."""
        wanted = indicated is not None if self.active is None else released
        if self.active is not None and indicated is not None:
            self._since = None
            if indicated > self.active:
                self.active, self.cause = indicated, cause
                return [self._event(stamp, EventState.RAISED, quantity, _written(message))]
            return []
        if not wanted:
            self._since = None
            return []
        if self._since is None or stamp < self._since:
            self._since = stamp
        if stamp - self._since < round((self.on_delay if self.active is None else self.off_delay) * 1e9):
            return []
        self._since = None
        if self.active is None:
            assert indicated is not None
            self.active, self.cause = indicated, cause
            return [self._event(stamp, EventState.RAISED, quantity, _written(message))]
        return self.clear(stamp, quantity, f"{self.kind} is over: {_written(message)}")

    def clear(self, stamp: int, quantity: Quantity, message: str) -> list[Event]:
        """End the condition at once where it is active."""
        if self.active is None:
            return []
        event = self._event(stamp, EventState.CLEARED, quantity, message)
        self.active, self.cause, self._since = None, "", None
        return [event]

    @property
    def name(self) -> str:
        """What tells this condition from the valve's others, e.g. ``friction_drift/coulomb_force``."""
        return condition_name(self.kind, self.source)

    def restore(self, severity: Severity, cause: str) -> None:
        """Go on as active, as it was before a restart; no event follows."""
        self.active, self.cause, self._since = severity, cause, None

    def _event(self, stamp: int, state: EventState, quantity: Quantity, message: str) -> Event:
        assert self.active is not None
        return Event(stamp, self.kind, state, self.active, self.cause, quantity, message, self.source)


def _written(text: Text) -> str:
    return text if isinstance(text, str) else text()
