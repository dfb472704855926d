"""Streams of events: channels, their readers and connections, and the step that sends changes."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from spool_monitor.valve_condition import condition_of
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from spool_view.operator import Desk
from spool_view.view import HeardValve, detail_of, row_of

#: s between two steps, and between two signs of life: what a page does not hear it does not believe.
PERIOD, BEAT = 0.5, 2.0
#: Streams that may be open.
MOST_STREAMS = 64

_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]

#: Events that a reader may be behind (4 s), and bytes of them.
MOST_BEHIND, MOST_BYTES = 8, 2_000_000

#: s that the head of a request may take.
HEAD = 10.0
#: B that the system may hold for a reader that does not read.
SEND_BUFFER = 131_072

_OPEN: dict[tuple[str, int], asyncio.Transport] = {}


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


class MachineChannel:
    """Machine's channel: rows and alarms that changed since the last step."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.readers: set[Reader] = set()
        self._rows: dict[str, dict[str, Any]] = {}
        self._alarms: dict[str, tuple[dict[str, Any], ...]] = {}
        self._seen: dict[str, tuple[int, str]] = {}

    def join(self, reader: Reader) -> None:
        """Give ``reader`` all there is, and what changes from now on."""
        if not self.readers:
            self._seen.clear()
        self.step()
        reader.offer(
            encode("machine", {"whole": True, "rows": list(self._rows.values()), "alarms": self._alarms})
        )
        self.readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Take note that ``reader`` is gone."""
        self.readers.discard(reader)

    def step(self) -> None:
        """Send what changed."""
        now = time.monotonic()
        rows, alarms = [], {}
        for name, valve in list(self._desk.board.valves.items()):
            seen = (valve.changes, condition_of(valve.health, now - valve.health_at))
            if self._seen.get(name) == seen:
                continue
            self._seen[name] = seen
            row = row_of(valve, now)
            if self._rows.get(name) != row:
                self._rows[name] = row
                rows.append(row)
            if self._alarms.get(name, ()) != valve.alarms:
                self._alarms[name] = alarms[name] = valve.alarms
        if (rows or alarms) and self.readers:
            event = encode("machine", {"whole": False, "rows": rows, "alarms": alarms})
            for reader in tuple(self.readers):
                reader.offer(event)


class ValveChannel:
    """Valve's channel: its view where it changed, and its spectrum."""

    def __init__(self, desk: Desk, name: str) -> None:
        self._desk, self._name = desk, name
        self.readers: set[Reader] = set()
        self._detail: dict[str, Any] = {}
        self._event = b""
        self._newest: bytes | None = None

    def join(self, reader: Reader) -> None:
        """Give ``reader`` all there is, and what changes from now on."""
        self._desk.board.opened(self._name)
        self.step()
        reader.offer(self._event)
        self.readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Take note that ``reader`` is gone."""
        if reader in self.readers:
            self.readers.discard(reader)
            self._desk.board.closed(self._name)

    def step(self) -> None:
        """Send what changed."""
        valve = self._desk.board.valves.get(self._name) or HeardValve(self._name)
        detail = detail_of(valve, time.monotonic())
        events = []
        if detail != self._detail:
            self._detail, self._event = detail, encode("valve", detail)
            events.append(self._event)
        blocks = list(valve.blocks)
        if self.readers and blocks and blocks[-1] is not self._newest:
            self._newest = blocks[-1]
            found = self._desk.spectrum(blocks)
            if found is not None:
                events.append(encode("spectrum", found))
        for event in events:
            for reader in tuple(self.readers):
                reader.offer(event)


def encode(event: str, data: Any) -> bytes:
    """Return a server-sent event (WHATWG HTML, 9.2)."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return f"event: {event}\ndata: {text}\n\n".encode("ascii")


class Reader:
    """A browser's open stream; ``drop`` ends its connection at once."""

    def __init__(self, drop: Callable[[], object]) -> None:
        self._drop = drop
        self._waiting: deque[bytes] = deque()
        self._bytes = 0
        self._news = asyncio.Event()
        self.ended = False

    def offer(self, event: bytes) -> None:
        """Hand over an event; a reader that is too far behind is dropped."""
        if self.ended:
            return
        self._waiting.append(event)
        self._bytes += len(event)
        if len(self._waiting) > MOST_BEHIND or (self._bytes > MOST_BYTES and len(self._waiting) > 1):
            self.end()
            self._drop()
        self._news.set()

    def end(self) -> None:
        """End the stream after what is being sent."""
        self.ended = True
        self._waiting.clear()
        self._bytes = 0
        self._news.set()

    async def next(self) -> bytes | None:
        """Return all that waits, ``None`` at the end."""
        while not self._waiting and not self.ended:
            self._news.clear()
            await self._news.wait()
        if self.ended:
            return None
        events = b"".join(self._waiting) if len(self._waiting) > 1 else self._waiting[0]
        self._waiting.clear()
        self._bytes = 0
        return events


class PageProtocol(H11Protocol):
    """Protocol of a connection of the page."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take up a connection."""
        super().connection_made(transport)
        own = transport.get_extra_info("socket")
        if own is not None:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            # Else each answer on a kept connection waits 40 ms for an acknowledgement of its head.
            own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self.client is not None:
            _OPEN[self.client[0], self.client[1]] = transport
        self._late = asyncio.get_running_loop().call_later(HEAD, self._end_if_silent)

    def connection_lost(self, exc: Exception | None) -> None:
        """Take note that it ended."""
        self._late.cancel()
        if self.client is not None:
            _OPEN.pop((self.client[0], self.client[1]), None)
        super().connection_lost(exc)

    def _end_if_silent(self) -> None:
        cycle: object = self.cycle  # None before the first request, whatever its type says
        if cycle is None:
            self.transport.abort()


def abort(client: Any) -> None:
    """End the connection of ``client`` (address and port) at once, whatever it has not read."""
    transport = _OPEN.get(tuple(client)) if client else None
    if transport is not None:
        transport.abort()


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
