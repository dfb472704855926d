"""Alarm and its transitions, after ISA-18.2 (IEC 62682) and OPC UA Part 9; no clock, no ROS."""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

from spool_core.errors import InputError, operator_missing

from spool_monitor.detectors import event_kind
from spool_monitor.event import Event, EventState, Namur, Severity, condition_name

#: s, the longest time on a shelf, a week: ISA-18.2 (11.7.3) asks for a limit, so that no alarm is forgotten.
LONGEST_SHELF = 604800.0

#: s, the longest time out of service that has an end: chosen, a year; what lasts longer has none.
LONGEST_SERVICE = 366 * 86400.0


class AlarmState(enum.IntEnum):
    """State of an alarm (IEC 62682, figure 6); the numbers are those of ``spool_msgs/msg/Alarm``.

    Out of service hides suppressed, that hides shelved, that hides the others.
    """

    UNKNOWN = 0
    NORMAL = 1
    UNACKNOWLEDGED = 2  # active, nobody has seen it
    ACKNOWLEDGED = 3  # active, seen
    RETURNED_UNACKNOWLEDGED = 4  # over, and nobody has seen it
    LATCHED_UNACKNOWLEDGED = 5  # over, kept until acknowledged and reset
    LATCHED_ACKNOWLEDGED = 6  # over, seen, kept until reset
    SHELVED = 7  # put aside by an operator, for a time
    SUPPRESSED = 8  # put aside by the plant's logic
    OUT_OF_SERVICE = 9  # put aside for maintenance


class Input(enum.Enum):
    """Input of an alarm's state machine: what can happen to it."""

    RAISE = "raise"
    CLEAR = "clear"
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    EXPIRE = "expire"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    REMOVE_FROM_SERVICE = "remove from service"
    RETURN_TO_SERVICE = "return to service"


class Action(enum.Enum):
    """Action of an operator's display about a transition."""

    ANNOUNCE = "announce"  # show it, sound the horn: somebody has to acknowledge
    SILENCE = "silence"  # it has been acknowledged
    RETURN = "return"  # show that it is over
    HIDE = "hide"
    SHOW = "show"


class AlarmRefusedError(InputError):
    """Refusal: the alarm is in no state for that; the message says why."""


@dataclass(frozen=True, slots=True)
class Operator:
    """Operator who does something to an alarm, when (ns), and the comment on it."""

    who: str
    stamp: int
    comment: str = ""

    def __post_init__(self) -> None:
        if not self.who.strip():
            raise AlarmRefusedError(operator_missing())


@dataclass(frozen=True, slots=True)
class Alarm:
    """One condition of a valve as an operator sees it; times in ns, 0: never.

    ``active`` and ``severity`` follow the condition; ``event`` is its last one, ``None`` before the first.
    ``occurrence`` counts how often it was announced.
    ``acknowledged_by``, ``acknowledged_at`` and ``comment`` are of the acknowledgement of this occurrence.
    ``shelved_until`` is 0 for a shelf that lasts until the condition is over, ``serviced_until`` for
    maintenance without an end.
    """

    kind: str
    source: str = ""
    latching: bool = False
    active: bool = False
    acknowledged: bool = True
    latched: bool = False
    shelved: bool = False
    suppressed: bool = False
    out_of_service: bool = False
    severity: Severity = Severity.UNKNOWN
    cause: str = ""
    event: Event | None = None
    occurrence: int = 0
    raised_at: int = 0
    changed_at: int = 0
    acknowledged_at: int = 0
    acknowledged_by: str = ""
    comment: str = ""
    shelved_at: int = 0
    shelved_until: int = 0
    serviced_at: int = 0
    serviced_until: int = 0
    shelved_by: Operator | None = None
    suppressed_by: Operator | None = None
    serviced_by: Operator | None = None

    @property
    def name(self) -> str:
        """Name that distinguishes it from the valve's others, e.g. ``friction_drift/coulomb_force``."""
        return condition_name(self.kind, self.source)

    @property
    def code(self) -> int:
        """Stable number of kind and cause."""
        return event_kind(self.kind).cause(self.cause).code

    @property
    def kind_namur(self) -> Namur:
        """Status after NE 107 that kind and cause give a valve while active."""
        return event_kind(self.kind).cause(self.cause).namur

    @property
    def namur(self) -> Namur:
        """Status after NE 107 that it gives the valve now."""
        return self.kind_namur if self.active else Namur.NORMAL

    @property
    def hidden_until(self) -> int:
        """When the cover that shows ends, ns; 0: it has no time, or there is none."""
        if self.out_of_service:
            return self.serviced_until
        return 0 if self.suppressed else self.shelved_until

    @property
    def hidden_by(self) -> Operator | None:
        """Who laid on the cover that shows; ``None`` where there is none, or nobody knows."""
        if self.out_of_service:
            return self.serviced_by
        return self.suppressed_by if self.suppressed else self.shelved_by

    @property
    def hidden(self) -> bool:
        """Whether it is kept from the operator's list."""
        return self.shelved or self.suppressed or self.out_of_service

    @property
    def state(self) -> AlarmState:
        """The state that shows."""
        if self.out_of_service:
            return AlarmState.OUT_OF_SERVICE
        if self.suppressed:
            return AlarmState.SUPPRESSED
        return AlarmState.SHELVED if self.shelved else self.underlying

    @property
    def underlying(self) -> AlarmState:
        """The state beneath shelf, suppression and maintenance."""
        if self.active:
            return AlarmState.ACKNOWLEDGED if self.acknowledged else AlarmState.UNACKNOWLEDGED
        if self.latched:
            seen = AlarmState.LATCHED_ACKNOWLEDGED
            return seen if self.acknowledged else AlarmState.LATCHED_UNACKNOWLEDGED
        return AlarmState.NORMAL if self.acknowledged else AlarmState.RETURNED_UNACKNOWLEDGED


@dataclass(frozen=True, slots=True)
class Transition:
    """Transition of an alarm by an input."""

    before: Alarm
    input: Input
    after: Alarm
    actions: tuple[Action, ...] = ()

    @property
    def changed(self) -> bool:
        """Whether the alarm is another one now."""
        return self.before != self.after


def follow(alarm: Alarm, event: Event) -> Transition:
    """Take the beginning, growth or end of the alarm's condition in.

    A warning that grows to an alarm wants a new acknowledgement; an alarm that eases to a warning wants none.
    What comes and goes while hidden wants none, but a latch holds.
    """
    if event.state is EventState.CLEARED:
        if not alarm.active:
            return Transition(alarm, Input.CLEAR, alarm)
        after = replace(
            alarm,
            active=False,
            latched=alarm.latching,
            acknowledged=alarm.acknowledged or (alarm.hidden and not alarm.latching),
            event=event,
            changed_at=event.stamp,
        )
        if alarm.shelved and not alarm.shelved_until:
            after = _unshelved(after)
            return Transition(alarm, Input.CLEAR, after, _cover_actions(alarm, after))
        return Transition(alarm, Input.CLEAR, after, () if alarm.hidden else (Action.RETURN,))
    grown = not alarm.active or event.severity > alarm.severity
    after = replace(
        alarm,
        active=True,
        severity=event.severity,
        cause=event.cause,
        event=event,
        changed_at=event.stamp if event.severity != alarm.severity else alarm.changed_at,
    )
    if not grown:
        return Transition(alarm, Input.RAISE, after)
    after = replace(
        after,
        acknowledged=False,
        acknowledged_by="",
        acknowledged_at=0,
        comment="",
        latched=False,
        occurrence=alarm.occurrence + 1,
        raised_at=alarm.raised_at if alarm.active else event.stamp,
        changed_at=event.stamp,
    )
    return Transition(alarm, Input.RAISE, after, () if alarm.hidden else (Action.ANNOUNCE,))


def acknowledge(alarm: Alarm, operator: Operator, occurrence: int = 0) -> Transition:
    """Note that ``operator`` has seen it.

    Raises:
        AlarmRefusedError: nothing waits for it, or ``occurrence`` (0: any) is not the one seen.

    """
    if alarm.acknowledged:
        by = f", {alarm.acknowledged_by} acknowledged it" if alarm.active and alarm.acknowledged_by else ""
        raise AlarmRefusedError(f"{alarm.name}: there is nothing to acknowledge{by}")
    if occurrence not in (0, alarm.occurrence):
        raise AlarmRefusedError(
            f"{alarm.name}: occurrence {occurrence} is not current; look at number {alarm.occurrence} first"
        )
    after = replace(
        alarm,
        acknowledged=True,
        acknowledged_by=operator.who,
        acknowledged_at=operator.stamp,
        comment=operator.comment,
        changed_at=operator.stamp,
    )
    return Transition(alarm, Input.ACKNOWLEDGE, after, (Action.SILENCE,))


def reset(alarm: Alarm, operator: Operator) -> Transition:
    """Reset a latched alarm.

    Raises:
        AlarmRefusedError: not latched, still active, or not acknowledged (as OPC UA Part 9 has it).

    """
    if alarm.active:
        raise AlarmRefusedError(f"{alarm.name}: it is still active, so it can't be reset")
    if not alarm.latched:
        raise AlarmRefusedError(f"{alarm.name}: it is not latched, so there is nothing to reset")
    if not alarm.acknowledged:
        raise AlarmRefusedError(f"{alarm.name}: acknowledge it before you reset it")
    after = replace(alarm, latched=False, changed_at=operator.stamp)
    return Transition(alarm, Input.RESET, after, (Action.RETURN,))


def shelve(alarm: Alarm, operator: Operator, seconds: float) -> Transition:
    """Shelve the alarm for ``seconds``, or until the condition is over (0); shelving again sets a new end.

    Raises:
        AlarmRefusedError: negative or too long a time, or 0 where the condition is not active.

    """
    if not 0.0 <= seconds <= LONGEST_SHELF:
        raise AlarmRefusedError(
            f"{alarm.name}: it cannot be shelved for {seconds:g} s: use 0 to {LONGEST_SHELF:g} s (7 days), "
            "or suppress the alarm"
        )
    if seconds == 0.0 and not alarm.active:
        raise AlarmRefusedError(
            f"{alarm.name}: it is not active, so it cannot be shelved until it is over: give seconds"
        )
    until = operator.stamp + round(seconds * 1e9) if seconds else 0
    after = replace(alarm, shelved=True, shelved_at=operator.stamp, shelved_until=until, shelved_by=operator)
    return _covered(alarm, Input.SHELVE, operator, after)


def unshelve(alarm: Alarm, operator: Operator) -> Transition:
    """Take it off the shelf.

    Raises:
        AlarmRefusedError: it is not shelved.

    """
    if not alarm.shelved:
        raise AlarmRefusedError(f"{alarm.name}: it is not shelved")
    return _covered(alarm, Input.UNSHELVE, operator, _unshelved(alarm))


def expire(alarm: Alarm, stamp: int) -> Transition:
    """End a shelf or a time out of service that is over at ``stamp`` (ns).

    One from a time still to come ends too: a clock set back would lengthen it otherwise.
    """
    after, what = alarm, Input.EXPIRE
    if alarm.serviced_until and not alarm.serviced_at <= stamp < alarm.serviced_until:
        after = replace(after, out_of_service=False, serviced_at=0, serviced_until=0, serviced_by=None)
        what = Input.RETURN_TO_SERVICE
    if alarm.shelved_until and not alarm.shelved_at <= stamp < alarm.shelved_until:
        after = _unshelved(after)
    if after == alarm:
        return Transition(alarm, what, alarm)
    after = replace(after, changed_at=stamp)
    return Transition(alarm, what, after, _cover_actions(alarm, after))


def suppress(alarm: Alarm, operator: Operator, *, on: bool) -> Transition:
    """Suppress the alarm because the plant's state makes it meaningless, or undo that.

    Raises:
        AlarmRefusedError: it is so already.

    """
    if alarm.suppressed is on:
        raise AlarmRefusedError(f"{alarm.name}: it is {'suppressed already' if on else 'not suppressed'}")
    what = Input.SUPPRESS if on else Input.UNSUPPRESS
    return _covered(
        alarm, what, operator, replace(alarm, suppressed=on, suppressed_by=operator if on else None)
    )


def maintain(alarm: Alarm, operator: Operator, *, on: bool, seconds: float = 0.0) -> Transition:
    """Take the alarm out of service for maintenance, or undo that.

    Args:
        alarm: the alarm.
        operator: who does it, and when.
        on: out of service, or back into it.
        seconds: when it returns by itself; a later call sets a new end; 0: somebody has to return it.

    Raises:
        AlarmRefusedError: it is so already, or the time is negative or longer than a year.

    """
    if not 0.0 <= seconds <= LONGEST_SERVICE:
        raise AlarmRefusedError(
            f"{alarm.name}: {seconds:g} s is no time out of service: use 0 (no end) to "
            f"{LONGEST_SERVICE:g} s (a year)"
        )
    if alarm.out_of_service is on and not (on and seconds):
        raise AlarmRefusedError(f"{alarm.name}: it is {'out of service already' if on else 'in service'}")
    what = Input.REMOVE_FROM_SERVICE if on else Input.RETURN_TO_SERVICE
    timed = on and seconds > 0.0
    after = replace(
        alarm,
        out_of_service=on,
        serviced_at=operator.stamp if timed else 0,
        serviced_until=operator.stamp + round(seconds * 1e9) if timed else 0,
        serviced_by=operator if on else None,
    )
    return _covered(alarm, what, operator, after)


def _unshelved(alarm: Alarm) -> Alarm:
    return replace(alarm, shelved=False, shelved_at=0, shelved_until=0, shelved_by=None)


def _cover_actions(before: Alarm, after: Alarm) -> tuple[Action, ...]:
    """Return what shows when a cover is laid on or taken off: nothing where another one is there."""
    if before.hidden == after.hidden:
        return ()
    if after.hidden:
        return (Action.HIDE,)
    return (Action.SHOW,) if after.acknowledged else (Action.SHOW, Action.ANNOUNCE)


def _covered(before: Alarm, what: Input, operator: Operator, after: Alarm) -> Transition:
    after = replace(after, changed_at=operator.stamp)
    return Transition(before, what, after, _cover_actions(before, after))
