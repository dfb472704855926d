"""Condition of a valve: makes events of what detectors find."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from spool_core.text import Account, duration, over, raised, urgency
from spool_core.uncertainty import Quantity

from .event import Event, EventState, Severity, condition_name
from .event_kind import EventKind

#: What there is to tell, or what makes it: most of what is judged is never told. A string is what is seen.
Told = str | Account
Text = Told | Callable[[], Told]

#: What is said of the time to a limit where nothing is followed over time.
NO_TREND = "no trend tells a time"


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
