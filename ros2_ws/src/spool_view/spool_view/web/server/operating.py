"""Requests that are answered once: an operator's acts, records of a valve."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spool_core.errors import InputError
from spool_view.web.server.operator import (
    Act,
    ActLog,
    ActRefusedError,
    OperatorToken,
    Outcome,
    RateLimit,
    act_of,
)
from spool_view.web.server.view import RANGES, Board, trend_of
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response

#: B of a request, s that it may take to come in.
MOST_BODY, BODY = 4096, 5.0
#: Acts a second, and at once; wrong tokens likewise.
ACTS, ACTS_AT_ONCE = 1.0, 10.0
WRONG, WRONG_AT_ONCE = 0.2, 10.0

#: Trends that are read at a time.
MOST_READINGS = 2


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
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        if not self._acts.take():
            return _answer(429, "too many acts in a short time: wait a few seconds")
        try:
            act = act_of(await _content(request), self._alarms())
        except ActRefusedError as error:
            return _answer(400, str(error))
        if not await self._note(step="asked", act=act):
            return _answer(503, "the log can't be written, so nothing is done")
        outcome = await self._outcome(act)
        noted = await self._note(step="done" if outcome.done else "refused", act=act, said=outcome.text)
        text = outcome.text if noted else f"{outcome.text} (and the log can't be written any more)"
        return _answer(200 if outcome.done else 409, text)

    def _refusal(self, request: Request) -> Response | None:
        if self._desk.token is None or self._desk.log is None:
            return _answer(403, "this page is read only: it was started without --operator")
        given = request.headers.getlist("authorization")
        if len(given) == 1 and self._desk.token.fits(given[0]):
            return None
        if self._warned.take():
            self._desk.warn("a request with a wrong token, or without one, was refused")
        return _answer(401, "the token is wrong") if self._wrong.take() else _answer(429, "too many tries")

    def _alarms(self) -> dict[str, frozenset[str]]:
        valves = list(self._desk.board.valves.values())
        return {valve.name: frozenset(alarm["name"] for alarm in valve.alarms) for valve in valves}

    async def _note(self, step: str, act: Act, **more: Any) -> bool:
        assert self._desk.log is not None
        try:
            await run_in_threadpool(self._desk.log.write, step=step, **asdict(act), **more)
        except OSError as error:
            self._desk.warn(f"the operators' log can't be written: {error}")
            return False
        return True

    async def _outcome(self, act: Act) -> Outcome:
        return await asyncio.wrap_future(self._desk.do(act))


class Records:
    """Records of one page; of valves that are heard only."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._free: asyncio.Semaphore | None = None

    async def trend(self, request: Request) -> Response:
        """Answer with a trend."""
        valve, length = request.query_params.get("valve", ""), request.query_params.get("range", "day")
        parameter = request.query_params.get("parameter", "")
        if valve not in self._desk.board.valves or length not in RANGES or len(parameter) > 200:
            return _nothing()
        self._free = self._free or asyncio.Semaphore(MOST_READINGS)
        async with self._free:
            try:
                found = await run_in_threadpool(trend_of, self._desk.state_folder, valve, parameter, length)
            except (InputError, OSError):  # names files: not for browsers
                return _nothing()
        return JSONResponse(found, headers={"cache-control": "no-store"})

    async def gap(self, request: Request) -> Response:
        """Answer with everything that the last gap analysis of a valve found."""
        valve = self._desk.board.valves.get(request.query_params.get("valve", ""))
        message = valve.gap if valve is not None else None
        if message is None or not message.json:
            return PlainTextResponse("no analysis is held: open the valve's page first", 404)
        name = f"gap_{message.header.stamp.sec}.json"
        headers = {"cache-control": "no-store", "content-disposition": f'attachment; filename="{name}"'}
        return Response(message.json, media_type="application/json", headers=headers)


@dataclass(frozen=True, slots=True)
class Desk:
    """Desk of a page: valves, where trends are kept, and, with an operator, ``do``, ``token`` and ``log``."""

    board: Board
    address: str
    state_folder: Path
    spectrum: Callable[[list[bytes]], dict[str, Any] | None]
    do: Callable[[Act], Future[Outcome]]
    token: OperatorToken | None
    log: ActLog | None
    warn: Callable[[str], object]

    @property
    def operable(self) -> bool:
        """Whether an operator may act; else the page is read only."""
        return self.token is not None and self.log is not None


async def _content(request: Request) -> Any:
    """Return the decoded body.

    Raises:
        ActRefusedError: it is too large, too slow, or no JSON.
    """
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise ActRefusedError("the request is no JSON")
    try:
        body = await asyncio.wait_for(_body(request), BODY)
        return json.loads(body)
    except (asyncio.TimeoutError, ValueError, RecursionError) as error:
        raise ActRefusedError("the request is no JSON") from error


async def _body(request: Request) -> bytes:
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY:
            raise ActRefusedError("the request is too large")
    return bytes(body)


def _answer(status: int, text: str) -> JSONResponse:
    return JSONResponse({"text": text}, status, {"cache-control": "no-store"})


def _nothing() -> Response:
    """Answer that there is none: no fault, a monitor that has just begun has kept nothing yet."""
    return JSONResponse({"parameters": [], "start": []}, headers={"cache-control": "no-store"})
