"""Operator of the page: who may act, how often, and the log of it."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import os
import secrets
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from types import MappingProxyType
from typing import Any

from spool_core.opcua_folder import KeptPassword
from spool_core.system import FILE_MODE, private_folder, restrict, write_durably
from spool_monitor.listener import HeardValve
from spool_monitor.shown import listed
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from spool_view.acts import (
    MOST_LIST,
    WRONG,
    WRONG_AT_ONCE,
    Act,
    ActRefusedError,
    Outcome,
    RateLimit,
    act_of,
    acts_of,
)
from spool_view.metrics import Metrics

#: Random bytes of a token: it can't be guessed.
RANDOM = 32
#: Browsers in which an operator may be signed in by name and password: chosen, the oldest is signed out.
MOST_SIGNED_IN = 8

#: B of a request, s that it may take to come in.
MOST_BODY, BODY = 4096, 5.0
#: Acts a second, and in one burst: chosen, nobody clicks faster.
ACTS, ACTS_AT_ONCE = 1.0, 10.0


class OperatorToken:
    """Operators' way in: a token for all, kept in ``path`` (mode 0600) until :meth:`remove`.

    With ``passwords`` by name each operator signs in instead, for a token of this page's run.

    Raises:
        OSError: the file can't be made.
    """

    def __init__(self, path: Path, passwords: Mapping[str, KeptPassword] = MappingProxyType({})) -> None:
        self.path, self._passwords = path, passwords
        self._names: dict[str, str] = {}
        if passwords:
            return
        token = secrets.token_urlsafe(RANDOM)
        private_folder(path.parent)
        write_durably(path, f"{token}\n", mode=FILE_MODE)
        self._names[token] = ""

    @property
    def personal(self) -> bool:
        """Whether operators sign in by name and password."""
        return bool(self._passwords)

    def who(self, header: str) -> str | None:
        """Return whose token an ``Authorization`` header bears, empty: anybody's; ``None``: it bears none."""
        given = header.encode("utf-8", "replace")
        for one, who in list(self._names.items()):
            if hmac.compare_digest(given, f"Bearer {one}".encode()):
                return who
        return None

    def sign_in(self, name: str, password: str) -> str | None:
        """Return a token for the operator ``name``; ``None`` where name and password do not fit.

        It takes as long for a name that nobody has.
        """
        kept = self._passwords.get(name)
        fits = (kept or next(iter(self._passwords.values()))).fits(password)
        if kept is None or not fits:
            return None
        for token in [one for one, who in self._names.items() if who == name][:-MOST_SIGNED_IN]:
            del self._names[token]
        token = secrets.token_urlsafe(RANDOM)
        self._names[token] = name
        return token

    def remove(self) -> None:
        """Take the file away, if it is still this one's."""
        with contextlib.suppress(OSError):
            if self.path.read_text(encoding="ascii").strip() in self._names:
                self.path.unlink()


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
        self._tries = RateLimit(WRONG, WRONG_AT_ONCE)
        self._warned = RateLimit(1.0 / 60.0, 1.0)

    async def check(self, request: Request) -> Response:
        """Say whether the token is right, or answer name and password with one."""
        token = self._desk.token
        if token is None or not token.personal:
            return self._refusal(request) or _answer(200, "right")
        try:
            given = await _content(request, MOST_BODY)
            name, password = (str(given[key]) for key in ("who", "token"))
        except (ActRefusedError, KeyError, TypeError):
            return _answer(400, "name and password are missing")
        if not self._tries.take():
            return _answer(429, "too many tries: wait a few seconds")
        made = await run_in_threadpool(token.sign_in, name, password)
        if made is None:
            return self._wrong_answer("name or password is wrong")
        return _answer(200, "right", token=made)

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
        return _answer(409 if len(refused) == len(asked) else 200, text)

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
        shown = {one.name: frozenset(alarm.name for alarm in listed(one.alarms)) for one in valves}
        try:
            acts = read(await _content(request, most), shown)
        except ActRefusedError as error:
            return _answer(400, str(error))
        assert self._desk.token is not None
        who = self._desk.token.who(request.headers["authorization"])
        return [replace(act, who=who) for act in acts] if who else acts

    async def _done(self, act: Act) -> tuple[int, str]:
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
        if len(given) == 1 and self._desk.token.who(given[0]) is not None:
            return None
        again = "sign in again: the page was restarted" if self._desk.token.personal else "the token is wrong"
        return self._wrong_answer(again)

    def _wrong_answer(self, text: str) -> Response:
        if self._warned.take():
            self._desk.warn("a request with a wrong token or password, or without one, was refused")
        return _answer(401, text) if self._wrong.take() else _answer(429, "too many tries")

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


async def _content(request: Request, most: int) -> Any:
    """Return the decoded body of ``most`` B.

    Raises:
        ActRefusedError: it is too large, too slow, or no JSON.
    """
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise ActRefusedError("the request is no JSON")
    try:
        return json.loads(await asyncio.wait_for(_body(request, most), BODY))
    except (asyncio.TimeoutError, ValueError, RecursionError) as error:
        raise ActRefusedError("the request is no JSON") from error


async def _body(request: Request, most: int) -> bytes:
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > most:
            raise ActRefusedError("the request is too large")
    return bytes(body)


def _answer(status: int, text: str, **more: str) -> JSONResponse:
    return JSONResponse({"text": text, **more}, status)
