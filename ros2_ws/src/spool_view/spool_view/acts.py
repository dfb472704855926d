"""Operators' acts: what can be asked for, and how the valve's nodes are asked for it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from rcl_interfaces.srv import GetParameters
from spool_core.errors import operator_missing
from spool_core.node.service_calls import ServiceCalls
from spool_msgs import srv
from std_srvs.srv import Trigger

ACKNOWLEDGE, SHELVE, UNSHELVE, RESET = "acknowledge", "shelve", "unshelve", "reset"
MAINTAIN, RETURN = "maintain", "return_to_service"
FREEZE, LEARN, ANALYSE, SNAPSHOT = "freeze_baseline", "learn_baseline", "analyse", "take_snapshot"
#: Acts on alarms, and on the valve; out of service is one or all alarms of a valve.
ON_ALARM = (ACKNOWLEDGE, SHELVE, UNSHELVE, RESET, MAINTAIN, RETURN)
ON_VALVE = (FREEZE, LEARN, ANALYSE, SNAPSHOT, MAINTAIN, RETURN)
#: Characters of who acts and of a comment; minutes of a shelf.
MOST_WHO, MOST_COMMENT, MOST_MINUTES, MOST_SERVICE = 60, 200, 7 * 1440.0, 366 * 1440.0
#: Alarms that one request acts on at most, and B of such a request: chosen, they bound the work.
MOST_TARGETS, MOST_LIST = 500, 100_000
_FIELDS = {"act", "valve", "alarm", "occurrence", "minutes", "who", "comment"}

#: Wrong tokens or passwords a second, and in one burst: chosen, a million guesses take two months.
WRONG, WRONG_AT_ONCE = 0.2, 10.0

#: Nodes that do what the monitor does not.
_NODES = {ANALYSE: "estimator", SNAPSHOT: "recorder"}

#: Services that can be called: node and type by name; there is no way to any other.
SERVICES: dict[str, tuple[str, Any]] = {
    "acknowledge_alarm": ("monitor", srv.AcknowledgeAlarm),
    "shelve_alarm": ("monitor", srv.ShelveAlarm),
    "reset_alarms": ("monitor", srv.ResetAlarms),
    "suppress_alarm": ("monitor", srv.SuppressAlarm),
    "manage_baseline": ("monitor", srv.ManageBaseline),
    "get_parameters": ("monitor", GetParameters),
    "analyse_gap": ("estimator", Trigger),
    "take_snapshot": ("recorder", srv.TakeSnapshot),
}
#: Nodes that serve all valves, outside of their namespaces.
SHARED = {"recorder"}


@dataclass(slots=True)
class RateLimit:
    """``burst`` at once, refilled by ``rate`` a second (token bucket)."""

    rate: float
    burst: float
    clock: Callable[[], float] = time.monotonic
    _left: float = field(init=False)
    _last: float = field(init=False)

    def __post_init__(self) -> None:
        self._left, self._last = self.burst, self.clock()

    def take(self) -> bool:
        """Return whether one more is within the limit, and count it if so."""
        now = self.clock()
        self._left = min(self.burst, self._left + self.rate * (now - self._last))
        self._last = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class ActRefusedError(Exception):
    """The request is none; the text says why, in one line."""


@dataclass(frozen=True, slots=True)
class Act:
    """What ``who`` wants of ``valve``; ``alarm`` and its ``occurrence`` seen, ``minutes`` that it takes."""

    act: str
    valve: str
    who: str
    comment: str = ""
    alarm: str = ""
    occurrence: int = 0
    minutes: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of an act: whether it was done, and one line for people."""

    done: bool
    text: str


def act_of(given: Any, alarms: Mapping[str, frozenset[str]]) -> Act:
    """Return the act that ``given`` (decoded JSON) asks for.

    Args:
        given: object with ``act``, ``valve``, ``who``, ``comment``; of an alarm ``alarm``, ``occurrence``; of
            a shelf and of maintenance ``minutes``.
        alarms: names of the alarms that are shown, by valve.

    Raises:
        ActRefusedError: it is no act, or one on something that is not there.
    """
    if not isinstance(given, dict) or not set(given) <= _FIELDS:
        raise ActRefusedError("the request is not an object with the fields of an act")
    act = given.get("act")
    if act not in (*ON_ALARM, *ON_VALVE):
        raise ActRefusedError("unknown action")
    valve = given.get("valve")
    if not isinstance(valve, str) or valve not in alarms:
        raise ActRefusedError("unknown valve: the page receives no data from it")
    who = _text(given, "who", MOST_WHO)
    if not who:
        raise ActRefusedError(operator_missing())
    comment = _text(given, "comment", MOST_COMMENT)
    if act in ON_VALVE and "alarm" not in given:
        return Act(act, valve, who, comment, minutes=_minutes(act, given))
    alarm = given.get("alarm")
    if not isinstance(alarm, str) or not alarm or alarm not in alarms[valve]:
        raise ActRefusedError("no such alarm is shown")
    occurrence = given.get("occurrence", 0)
    if type(occurrence) is not int or not 0 <= occurrence < 2**32:
        raise ActRefusedError("occurrence: must be a whole number from 0")
    return Act(act, valve, who, comment, alarm, occurrence, _minutes(act, given))


def acts_of(given: Any, alarms: Mapping[str, frozenset[str]]) -> list[Act]:
    """Return the acts on several alarms that ``given`` asks for: as of one, with ``targets`` for the alarms.

    Raises:
        ActRefusedError: one of them is no act; nothing is done.
    """
    targets = given.get("targets") if isinstance(given, dict) else None
    if not isinstance(targets, list) or not 0 < len(targets) <= MOST_TARGETS:
        raise ActRefusedError(f"targets: 1 to {MOST_TARGETS} alarms")
    if given.get("act") not in ON_ALARM or not all(isinstance(one, dict) for one in targets):
        raise ActRefusedError("unknown action on alarms")
    common = {name: value for name, value in given.items() if name != "targets"}
    return [act_of({**common, **one}, alarms) for one in targets]


def do(calls: ServiceCalls, act: Act) -> Future[Outcome]:
    """Ask for ``act``; the outcome comes once the valve's node has answered, or is not there."""
    service, request = _request(act)
    outcome: Future[Outcome] = Future()

    def take(answer: Future[Any]) -> None:
        outcome.set_result(_outcome(act, answer.result()))

    ask(calls, act.valve, service, request).add_done_callback(take)
    return outcome


def ask(calls: ServiceCalls, valve: str, service: str, request: Any) -> Future[Any]:
    """Return the answer to come, ``None`` in it where no node answers; from any thread."""
    node, kind = SERVICES[service]
    return calls.ask(f"/{node}" if node in SHARED else f"/{valve}/{node}", service, request, kind)


def _text(given: Mapping[str, Any], name: str, most: int) -> str:
    value = given.get(name, "")
    if not isinstance(value, str) or len(value) > most:
        raise ActRefusedError(f"{name}: must be a text of at most {most} characters")
    if not value.isprintable():
        raise ActRefusedError(f"{name}: must be one line without control characters")
    return value.strip()


def _minutes(act: str, given: Mapping[str, Any]) -> float:
    """Return the minutes of a shelf or of maintenance; 0 of other acts."""
    if act not in (SHELVE, MAINTAIN):
        return 0.0
    minutes, most = given.get("minutes"), MOST_MINUTES if act == SHELVE else MOST_SERVICE
    if isinstance(minutes, bool) or not isinstance(minutes, int | float) or not math.isfinite(minutes):
        raise ActRefusedError("minutes: a number, 0 without an end")
    if not 0 <= minutes <= most:
        raise ActRefusedError(f"minutes: must be from 0 to {most:g}")
    return float(minutes)


def _request(act: Act) -> tuple[str, Any]:
    by = {"who": act.who, "comment": act.comment}
    if act.act == ANALYSE:
        return "analyse_gap", Trigger.Request()
    if act.act == SNAPSHOT:
        return "take_snapshot", srv.TakeSnapshot.Request(valve=act.valve, **by)
    if act.act in (FREEZE, LEARN):
        kind = srv.ManageBaseline.Request
        return "manage_baseline", kind(action=kind.FREEZE if act.act == FREEZE else kind.LEARN, **by)
    by["alarm"] = act.alarm
    if act.act == ACKNOWLEDGE:
        return "acknowledge_alarm", srv.AcknowledgeAlarm.Request(occurrence=act.occurrence, **by)
    if act.act == RESET:
        return "reset_alarms", srv.ResetAlarms.Request(**by)
    if act.act in (MAINTAIN, RETURN):
        out = act.act == MAINTAIN
        way, duration = srv.SuppressAlarm.Request.OUT_OF_SERVICE, 60.0 * act.minutes
        return "suppress_alarm", srv.SuppressAlarm.Request(way=way, suppressed=out, duration=duration, **by)
    shelved = act.act == SHELVE
    return "shelve_alarm", srv.ShelveAlarm.Request(shelved=shelved, duration=60.0 * act.minutes, **by)


def _outcome(act: Act, answer: Any) -> Outcome:
    if answer is None:
        node = _NODES.get(act.act, "monitor")
        return Outcome(False, f"{act.valve}: its {node} does not answer")
    if act.act == ANALYSE:
        return Outcome(bool(answer.success), str(answer.message))
    if not answer.success:
        return Outcome(False, str(answer.reason))
    return Outcome(True, ", ".join(getattr(answer, "changed", ())) or str(getattr(answer, "stage", "")))
