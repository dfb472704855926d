"""What begins and ends on a valve."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from spool_estimator.gap_requests.gap_watch import MODEL_GAP, GapChange
from spool_stream.quantity import Quantity
from spool_stream.text.sentence import Account, over, raised

from .remedy import advice

#: What there is to tell, or what makes it: most of what is judged is never told. A string is what is seen.
Told = str | Account
Text = Told | Callable[[], Told]


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
    _indicated: int | None = field(default=None, init=False)
    _raised: int | None = field(default=None, init=False)

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
                return self._raise(stamp, indicated, cause, quantity, message)
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
            return self._raise(stamp, indicated, cause, quantity, message)
        return self.clear(stamp, quantity, message)

    def clear(self, stamp: int, quantity: Quantity, message: Text) -> list[Event]:
        """End the condition at once where it is active; ``message`` says what is seen now."""
        if self.active is None:
            return []
        # A clock that was set back makes no time negative.
        began = self._raised if self._raised is not None and self._raised <= stamp else None
        lasted = math.nan if began is None else 1e-9 * (stamp - began)
        event = self._event(stamp, EventState.CLEARED, quantity, over(self.kind, _account(message), lasted))
        self.active, self.cause = None, ""
        self._since = self._indicated = self._raised = None
        return [event]

    def _raise(
        self, stamp: int, severity: Severity, cause: str, quantity: Quantity, message: Text
    ) -> list[Event]:
        self.active, self.cause = severity, cause
        self._raised = stamp if self._raised is None else self._raised
        account = _account(message)
        if math.isnan(account.began) and self._indicated is not None:
            account = replace(account, began=1e-9 * (stamp - self._indicated))
        return [self._event(stamp, EventState.RAISED, quantity, raised(account, advice(self.kind, cause)))]

    @property
    def name(self) -> str:
        """What tells this condition from the valve's others, e.g. ``friction_drift/coulomb_force``."""
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
