"""Operator of the page: what can be asked for, by whom, how often, and the log of it."""

from __future__ import annotations

import contextlib
import hmac
import json
import math
import os
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spool_core.system import FILE_MODE, private_folder, restrict

ACKNOWLEDGE, SHELVE, UNSHELVE, RESET = "acknowledge", "shelve", "unshelve", "reset"
FREEZE, LEARN, ANALYSE, SNAPSHOT = "freeze_baseline", "learn_baseline", "analyse", "take_snapshot"
#: Acts on one alarm, and on the valve.
ON_ALARM, ON_VALVE = (ACKNOWLEDGE, SHELVE, UNSHELVE, RESET), (FREEZE, LEARN, ANALYSE, SNAPSHOT)
#: Characters of who acts and of a comment; minutes of a shelf.
MOST_WHO, MOST_COMMENT, MOST_MINUTES = 60, 200, 7 * 1440.0
_FIELDS = {"act", "valve", "alarm", "occurrence", "minutes", "who", "comment"}

#: Random bytes of a token: it can't be guessed.
RANDOM = 32


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


class OperatorToken:
    """Operator's token, kept in ``path`` (mode 0600) until :meth:`remove`.

    Raises:
        OSError: the file can't be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._token = secrets.token_urlsafe(RANDOM)
        private_folder(path.parent)
        new = path.with_name(f"{path.name}.new")
        new.unlink(missing_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
        with os.fdopen(os.open(new, flags, FILE_MODE), "w", encoding="ascii") as stream:
            stream.write(f"{self._token}\n")
        new.replace(path)

    def fits(self, header: str) -> bool:
        """Return whether an ``Authorization`` header bears the token; takes as long whatever it holds."""
        wanted = f"Bearer {self._token}".encode()
        return hmac.compare_digest(header.encode("utf-8", "replace"), wanted)

    def remove(self) -> None:
        """Take the file away, if it is still this one's."""
        with contextlib.suppress(OSError):
            if self.path.read_text(encoding="ascii").strip() == self._token:
                self.path.unlink()


@dataclass(slots=True)
class RateLimit:
    """Rate limit: ``burst`` at once, refilled by ``rate`` a second (token bucket)."""

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


class ActLog:
    """Log of acts in ``path``: a JSON object a line, only appended, on the disk when :meth:`write` returns.

    Raises:
        OSError: the file can't be made or written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        private_folder(path.parent)
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._descriptor = os.open(path, flags, FILE_MODE)
        restrict(path, FILE_MODE)

    def write(self, **fields: Any) -> None:
        """Append a line with the time (UTC) and ``fields``.

        Raises:
            OSError: it is not on the disk.
        """
        time = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        line = (json.dumps({"time": time, **fields}, ensure_ascii=True) + "\n").encode("ascii")
        with self._lock:
            if os.write(self._descriptor, line) != len(line):
                raise OSError(f"{self.path}: a line was cut off: is the disk full?")
            os.fsync(self._descriptor)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._descriptor)


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
