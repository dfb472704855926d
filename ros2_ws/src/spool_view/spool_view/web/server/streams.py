"""Streams of events: who reads what, and the step that sends changes twice a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import Receive, Scope, Send

from .channels import MachineChannel, ValveChannel
from .connections import abort
from .desk import Desk
from .readers import Reader, encode

#: s between two steps, and between two signs of life: what a page does not hear it does not believe.
PERIOD, BEAT = 0.5, 2.0
#: Streams that may be open.
MOST_STREAMS = 64

_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]


class Streams:
    """Streams of one server."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._machine = MachineChannel(desk)
        self._valves: dict[str, ValveChannel] = {}
        self._readers: set[Reader] = set()
        self._closed = False
        self._trouble = 0.0

    async def run(self) -> None:
        """Send what changes until it is cancelled; what goes wrong with one step is said, not the end."""
        beat = 0.0
        while True:
            await asyncio.sleep(PERIOD)
            try:
                if self._machine.readers:
                    self._machine.step()
                for channel in tuple(self._valves.values()):
                    channel.step()
                if time.monotonic() - beat >= BEAT:
                    beat = time.monotonic()
                    sign = encode("beat", {})
                    for reader in tuple(self._readers):
                        reader.offer(sign)
            except Exception as error:
                if time.monotonic() - self._trouble > 60.0:
                    self._trouble = time.monotonic()
                    self._desk.warn(f"a change could not be sent: {error!r}")

    def close(self) -> None:
        """End every stream; none begins after that."""
        self._closed = True
        for reader in tuple(self._readers):
            reader.end()

    async def machine(self, request: Request) -> Response:
        """Answer with the machine's stream."""
        return self._stream(request, self._machine.join, self._machine.leave)

    async def valve(self, request: Request) -> Response:
        """Answer with a valve's stream."""
        name = request.path_params["name"]

        def join(reader: Reader) -> None:
            self._valves.setdefault(name, ValveChannel(self._desk, name)).join(reader)

        def leave(reader: Reader) -> None:
            channel = self._valves.get(name)
            if channel is not None:
                channel.leave(reader)
                if not channel.readers:
                    del self._valves[name]

        return self._stream(request, join, leave)

    def _stream(
        self, request: Request, join: Callable[[Reader], None], leave: Callable[[Reader], None]
    ) -> Response:
        if self._closed or len(self._readers) >= MOST_STREAMS:
            return PlainTextResponse("too many pages are open", 503)
        client = request.scope.get("client")
        reader = Reader(lambda: abort(client))
        self._readers.add(reader)

        def left() -> None:
            self._readers.discard(reader)
            leave(reader)

        return _EventStream(reader, lambda: join(reader), left)


class _EventStream(Response):
    """Response that sends what a reader is offered until one side ends it."""

    def __init__(self, reader: Reader, join: Callable[[], None], left: Callable[[], None]) -> None:
        super().__init__()
        self._reader, self._join, self._left = reader, join, left

    async def __call__(self, _scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream (ASGI)."""
        gone = asyncio.ensure_future(self._watch(receive))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
            await send({"type": "http.response.body", "body": b"retry: 2000\n\n", "more_body": True})
            self._join()
            while (events := await self._reader.next()) is not None:
                await send({"type": "http.response.body", "body": events, "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})
        finally:
            gone.cancel()
            self._left()

    async def _watch(self, receive: Receive) -> None:
        """End the stream once the browser is gone."""
        while (await receive())["type"] != "http.disconnect":
            pass
        self._reader.end()
