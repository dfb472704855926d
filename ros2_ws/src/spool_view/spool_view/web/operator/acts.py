"""Acts of an operator: what can be asked for, and what a request may hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

ACKNOWLEDGE, SHELVE, UNSHELVE, RESET = "acknowledge", "shelve", "unshelve", "reset"
FREEZE, LEARN, ANALYSE, SNAPSHOT = "freeze_baseline", "learn_baseline", "analyse", "take_snapshot"
#: Acts on one alarm, and on the valve.
ON_ALARM, ON_VALVE = (ACKNOWLEDGE, SHELVE, UNSHELVE, RESET), (FREEZE, LEARN, ANALYSE, SNAPSHOT)
#: Characters of who acts and of a comment; minutes of a shelf.
MOST_WHO, MOST_COMMENT, MOST_MINUTES = 60, 200, 7 * 1440.0
_FIELDS = {"act", "valve", "alarm", "occurrence", "minutes", "who", "comment"}


class ActRefusedError(Exception):
    """Refused act: the request is none; the text says why, in one line."""


@dataclass(frozen=True, slots=True)
class Act:
    """Act: what ``who`` wants of ``valve``; ``alarm`` and its ``occurrence`` seen, ``minutes`` of a shelf."""

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
            a shelf ``minutes``.
        alarms: names of the alarms that are shown, by valve.

    Raises:
        ActRefusedError: it is no act, or one on something that is not there.
    """
    if not isinstance(given, dict) or not set(given) <= _FIELDS:
        raise ActRefusedError("the request is no object with the fields of an act")
    act = given.get("act")
    if act not in (*ON_ALARM, *ON_VALVE):
        raise ActRefusedError("there is no such act")
    valve = given.get("valve")
    if not isinstance(valve, str) or valve not in alarms:
        raise ActRefusedError("no such valve is heard")
    who = _text(given, "who", MOST_WHO)
    if not who:
        raise ActRefusedError("who: say who does this")
    comment = _text(given, "comment", MOST_COMMENT)
    if act in ON_VALVE:
        return Act(act, valve, who, comment)
    alarm = given.get("alarm")
    if not isinstance(alarm, str) or not alarm or alarm not in alarms[valve]:
        raise ActRefusedError("no such alarm is shown")
    occurrence = given.get("occurrence", 0)
    if type(occurrence) is not int or not 0 <= occurrence < 2**32:
        raise ActRefusedError("occurrence: no whole number from 0 on")
    return Act(act, valve, who, comment, alarm, occurrence, _minutes(given) if act == SHELVE else 0.0)


def _text(given: Mapping[str, Any], name: str, most: int) -> str:
    value = given.get(name, "")
    if not isinstance(value, str) or len(value) > most:
        raise ActRefusedError(f"{name}: a text of at most {most} characters")
    if not value.isprintable():
        raise ActRefusedError(f"{name}: one line without control characters")
    return value.strip()


def _minutes(given: Mapping[str, Any]) -> float:
    value = given.get("minutes")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ActRefusedError("minutes: a number, 0 until the condition is over")
    if not 0 <= value <= MOST_MINUTES:
        raise ActRefusedError(f"minutes: from 0 to {MOST_MINUTES:g}")
    return float(value)
