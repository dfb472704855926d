"""Operator of the page: what can be asked for, by whom, how often, the log of it, and how it is done."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import math
import os
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from spool_core.errors import operator_missing
from spool_core.system import FILE_MODE, private_folder, restrict, write_durably
from spool_monitor.listener import HeardValve
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from spool_view.metrics import Metrics
from spool_view.view import shown_alarms

ACKNOWLEDGE, SHELVE, UNSHELVE, RESET = "acknowledge", "shelve", "unshelve", "reset"
MAINTAIN, RETURN = "maintain", "return_to_service"
FREEZE, LEARN, ANALYSE, SNAPSHOT = "freeze_baseline", "learn_baseline", "analyse", "take_snapshot"
#: Acts on alarms, and on the valve; out of service is one or all alarms of a valve.
ON_ALARM = (ACKNOWLEDGE, SHELVE, UNSHELVE, RESET, MAINTAIN, RETURN)
ON_VALVE = (FREEZE, LEARN, ANALYSE, SNAPSHOT, MAINTAIN, RETURN)
#: Characters of who acts and of a comment; minutes of a shelf.
MOST_WHO, MOST_COMMENT, MOST_MINUTES, MOST_SERVICE = 60, 200, 7 * 1440.0, 366 * 1440.0
#: Alarms that one request acts on at most, and B of such a request.
MOST_TARGETS, MOST_LIST = 500, 100_000
_FIELDS = {"act", "valve", "alarm", "occurrence", "minutes", "who", "comment"}

#: Random bytes of a token: it can't be guessed.
RANDOM = 32

#: B of a request, s that it may take to come in.
MOST_BODY, BODY = 4096, 5.0
#: Acts a second, and in one burst; the same limits hold for wrong tokens.
ACTS, ACTS_AT_ONCE = 1.0, 10.0
WRONG, WRONG_AT_ONCE = 0.2, 10.0


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
        raise ActRefusedError("there is no such act")
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
        raise ActRefusedError("there is no such act on alarms")
    common = {name: value for name, value in given.items() if name != "targets"}
    return [act_of({**common, **one}, alarms) for one in targets]


class OperatorToken:
    """Operator's token, kept in ``path`` (mode 0600) until :meth:`remove`.

    Raises:
        OSError: the file can't be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._token = secrets.token_urlsafe(RANDOM)
        private_folder(path.parent)
        write_durably(path, f"{self._token}\n", mode=FILE_MODE)

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
        """Close the file."""
        os.close(self._descriptor)


class Operating:
    """Operating of one page."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._acts = RateLimit(ACTS, ACTS_AT_ONCE)
        self._wrong = RateLimit(WRONG, WRONG_AT_ONCE)
        self._warned = RateLimit(1.0 / 60.0, 1.0)

    async def check(self, request: Request) -> Response:
        """Say whether the token is right."""
        return self._refusal(request) or _answer(200, "right")

    async def act(self, request: Request) -> Response:
        """Do an operator's act: it is in the log before it is done, and what came of it after."""
        asked = await self._asked(request, lambda given, shown: [act_of(given, shown)], MOST_BODY)
        return asked if isinstance(asked, Response) else _answer(*(await self._done(asked[0])))

    async def acts(self, request: Request) -> Response:
        """Do an act on several alarms, each logged by itself; answer how many were done."""
        asked = await self._asked(request, acts_of, MOST_LIST)
        if isinstance(asked, Response):
            return asked
        outcomes = await asyncio.gather(*(self._done(act) for act in asked))
        refused = [
            f"{act.valve} {act.alarm}: {text}"
            for act, (status, text) in zip(asked, outcomes, strict=True)
            if status != 200
        ]
        text = "; ".join([f"{len(asked) - len(refused)} of {len(asked)}", *refused[:5]])
        return _answer(409 if refused else 200, text)

    async def _asked(
        self, request: Request, read: Callable[[Any, Mapping[str, frozenset[str]]], list[Act]], most: int
    ) -> list[Act] | Response:
        """Return what an operator asks for, as ``read`` understands it, or the refusal."""
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        if not self._acts.take():
            return _answer(429, "too many acts in a short time: wait a few seconds")
        valves = list(self._desk.valves.values())
        shown = {one.name: frozenset(alarm.name for alarm in shown_alarms(one.alarms)) for one in valves}
        try:
            return read(await _content(request, most), shown)
        except ActRefusedError as error:
            return _answer(400, str(error))

    async def _done(self, act: Act) -> tuple[int, str]:
        """Do ``act`` and return the status and the text of the answer."""
        if not await self._note(step="asked", act=act):
            return 503, "the log can't be written, so the act is refused"
        outcome = await asyncio.wrap_future(self._desk.do(act))
        noted = await self._note(step="done" if outcome.done else "refused", act=act, said=outcome.text)
        text = outcome.text if noted else f"{outcome.text} (and the log can't be written any more)"
        return (200 if outcome.done else 409), text

    def _refusal(self, request: Request) -> Response | None:
        if self._desk.token is None or self._desk.log is None:
            return _answer(403, "this page is read only: it was started without --operator")
        given = request.headers.getlist("authorization")
        if len(given) == 1 and self._desk.token.fits(given[0]):
            return None
        if self._warned.take():
            self._desk.warn("a request with a wrong token, or without one, was refused")
        return _answer(401, "the token is wrong") if self._wrong.take() else _answer(429, "too many tries")

    async def _note(self, step: str, act: Act, **more: Any) -> bool:
        assert self._desk.log is not None
        try:
            await run_in_threadpool(self._desk.log.write, step=step, **asdict(act), **more)
        except OSError as error:
            self._desk.warn(f"the operators' log can't be written: {error}")
            return False
        return True


@dataclass(frozen=True, slots=True)
class Desk:
    """Desk of a page: valves, where trends are kept, and, with an operator, ``do``, ``token`` and ``log``.

    ``open``: names of the valves whose page a browser has open, those opened first at the front.
    ``metrics``: what ``/metrics`` serves; without them there is no such page.
    """

    valves: dict[str, HeardValve]
    open: list[str]
    address: str
    state_folder: Path
    spectrum: Callable[[list[bytes]], dict[str, Any] | None]
    do: Callable[[Act], Future[Outcome]]
    token: OperatorToken | None
    log: ActLog | None
    warn: Callable[[str], object]
    metrics: Metrics | None = None

    @property
    def operable(self) -> bool:
        """Whether an operator may act; else the page is read only."""
        return self.token is not None and self.log is not None


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


async def _content(request: Request, most: int) -> Any:
    """Return the decoded body of ``most`` B.

    Raises:
        ActRefusedError: it is too large, too slow, or no JSON.
    """
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise ActRefusedError("the request is no JSON")
    try:
        body = await asyncio.wait_for(_body(request, most), BODY)
        return json.loads(body)
    except (asyncio.TimeoutError, ValueError, RecursionError) as error:
        raise ActRefusedError("the request is no JSON") from error


async def _body(request: Request, most: int) -> bytes:
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > most:
            raise ActRefusedError("the request is too large")
    return bytes(body)


def _answer(status: int, text: str) -> JSONResponse:
    return JSONResponse({"text": text}, status, {"cache-control": "no-store"})
