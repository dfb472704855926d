"""What begins and ends on a valve."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

from spool_stream.quantity import Quantity


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


@dataclass(frozen=True, slots=True)
class Event:
    """Something began or ended at ``stamp`` (ns, acquisition time)."""

    stamp: int
    kind: str
    state: EventState
    severity: Severity
    cause: str
    quantity: Quantity
    message: str


@dataclass(slots=True)
class Condition:
    """Turn a wavering indication into one event on and one event off.

    It is raised when the indication held for ``on_delay`` s, cleared when the release held for
    ``off_delay`` s; between both (the deadband) nothing changes. A higher severity is reported at once.
    """

    kind: str
    on_delay: float
    off_delay: float
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
        message: str,
    ) -> list[Event]:
        """Return the event that follows, if any; where ``stamp`` (ns) goes back, the delay starts anew."""
        wanted = indicated is not None if self.active is None else released
        if self.active is not None and indicated is not None:
            self._since = None
            if indicated > self.active:
                self.active, self.cause = indicated, cause
                return [Event(stamp, self.kind, EventState.RAISED, indicated, cause, quantity, message)]
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
            return [Event(stamp, self.kind, EventState.RAISED, indicated, cause, quantity, message)]
        return self.clear(stamp, quantity, f"{self.kind} is over: {message}")

    def clear(self, stamp: int, quantity: Quantity, message: str) -> list[Event]:
        """End the condition at once where it is active."""
        if self.active is None:
            return []
        severity, cause = self.active, self.cause
        self.active, self.cause, self._since = None, "", None
        return [Event(stamp, self.kind, EventState.CLEARED, severity, cause, quantity, message)]
