"""What every viewer shows of a valve: one state, the alarm that it speaks of, and since when."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from spool_msgs.msg import Alarm, AlarmList, HealthEvent

from spool_monitor.listener import (
    ALARM,
    AT_REST,
    GOOD,
    LEARNING,
    NO_WORD,
    STALE,
    UNKNOWN,
    WAITING,
    WARNING,
    HeardValve,
)  # fmt: skip

#: A valve whose alarms were put aside by somebody: shelved, suppressed, or out of service.
PUT_ASIDE = "put_aside"
#: Worst first.
STATES = (ALARM, NO_WORD, STALE, WARNING, PUT_ASIDE, UNKNOWN, LEARNING, AT_REST, GOOD)
HIDDEN = (Alarm.STATE_SHELVED, Alarm.STATE_SUPPRESSED, Alarm.STATE_OUT_OF_SERVICE)
ACTIVE = (Alarm.STATE_UNACKNOWLEDGED, Alarm.STATE_ACKNOWLEDGED)
#: Alarms of one valve that are shown at most; a monitor has about twenty conditions.
MOST = 60


@dataclass(frozen=True, slots=True)
class ShownValve:
    """One valve as every viewer shows it.

    Attributes:
        name: of the valve.
        state: one of ``STATES``.
        reason: the alarm that the state speaks of; active, or hidden where the state is ``PUT_ASIDE``.
        since: s since 1970, from when the state holds; 0: not known.
        alarms: all that are not normal, the active and worst first, then those that are over, then hidden.
        waiting: how many of them wait for an operator.
    """

    name: str
    state: str
    reason: Alarm | None
    since: float
    alarms: tuple[Alarm, ...]
    waiting: int

    @property
    def rank(self) -> tuple[int, int, float, str]:
        """Sorts valves: the worst state first, then the most urgent, then the newest."""
        urgency = 0 if self.reason is None else int(self.reason.event.urgency)
        return STATES.index(self.state), -urgency, -self.since, self.name


def shown(valve: HeardValve, now: float, unix_time: float) -> ShownValve:
    """Return what is shown of ``valve``.

    Args:
        valve: as it was heard.
        now: s, monotonic.
        unix_time: s since 1970, at the same moment.
    """
    condition, alarms = valve.condition(now), listed(valve.alarms)
    waiting = sum(one.state in WAITING for one in alarms)
    if condition == NO_WORD:
        heard = 0.0 if valve.health is None else unix_time - (now - valve.health_at)
        return ShownValve(valve.name, NO_WORD, None, heard, alarms, waiting)
    reason = next((one for one in alarms if one.state in ACTIVE), None)
    if reason is not None:
        severe = ALARM if reason.severity == HealthEvent.SEVERITY_ALARM else WARNING
        state = condition if condition in (ALARM, STALE, WARNING) else severe
        return ShownValve(valve.name, state, reason, _seconds(reason.raised_at), alarms, waiting)
    aside = next((one for one in alarms if one.state in HIDDEN), None)
    served = valve.alarms is not None and all(
        one.state == Alarm.STATE_OUT_OF_SERVICE for one in valve.alarms.alarms
    )
    if aside is not None and (served or condition in (ALARM, STALE, WARNING)):
        return ShownValve(valve.name, PUT_ASIDE, aside, _seconds(aside.hidden_at), alarms, waiting)
    return ShownValve(valve.name, condition, None, 0.0, alarms, waiting)


def listed(message: AlarmList | None) -> tuple[Alarm, ...]:
    """Return the alarms that are not normal, ``MOST`` at most: active and worst first, over, hidden."""
    known = () if message is None else message.alarms
    named = [one for one in known if one.state not in (Alarm.STATE_NORMAL, Alarm.STATE_UNKNOWN)]
    return tuple(sorted(named, key=_rank)[:MOST])


def in_order(valves: Iterable[ShownValve]) -> Sequence[ShownValve]:
    """Return ``valves``, the one that needs somebody most first."""
    return sorted(valves, key=lambda one: one.rank)


def _rank(alarm: Alarm) -> tuple[bool, bool, int, int, bool, int, str]:
    return (
        alarm.state in HIDDEN,
        (alarm.underlying if alarm.state in HIDDEN else alarm.state) not in ACTIVE,
        -int(alarm.severity),
        -int(alarm.event.urgency),
        alarm.state not in WAITING,
        -alarm.raised_at.sec,
        alarm.name,
    )


def _seconds(stamp: object) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)  # type: ignore[attr-defined]
