"""Records of a valve that a page asks for: trends, and the report of the last gap analysis."""

from __future__ import annotations

import asyncio

from spool_core.errors import InputError
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response

from spool_view.web.view.trends import RANGES, trend_of

from .desk import Desk

#: Trends that are read at a time.
MOST_READINGS = 2


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


def _nothing() -> Response:
    """Answer that there is none: no fault, a monitor that has just begun has kept nothing yet."""
    return JSONResponse({"parameters": [], "start": []}, headers={"cache-control": "no-store"})
