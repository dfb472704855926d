"""Web application of the page: its requests, and the streams that keep browsers up to date."""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
import json
import re
import socket
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from jinja2 import BaseLoader, Environment, StrictUndefined
from spool_core.faults import unexpected
from spool_monitor.listener import HeardValve
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from spool_view.acts import RateLimit
from spool_view.kept import Records
from spool_view.operator import Desk, Operating
from spool_view.view import alarms_of, detail_of, row_of

#: Requests a second, and at once; ten browsers that load a page together need a hundred.
RATE, BURST = 100.0, 400.0

_HEADERS = [
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        b"base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=()"),
]

SITE = Path(__file__).resolve().parent / "site"
#: What reports draw charts with, too.
CHARTS = Path(str(files("spool_report"))) / "templates" / "vendor"
LANGUAGES = ("en", "de", "pl")
COOKIE = "spool_language"
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
#: Names of valves, as ROS 2 allows them for namespaces.
VALVE = re.compile(r"[A-Za-z0-9_]+(/[A-Za-z0-9_]+)*")
_OWN_PAGE = re.compile(r"/(alarms|history|valve/[A-Za-z0-9_/]{1,200})?")

#: Connections that may be open; s that requests under way get at the end.
MOST_CONNECTIONS, GRACE = 256, 1

#: s between two steps, and between two signs of life: what a page does not hear it does not believe.
PERIOD, BEAT = 0.5, 2.0
#: Spectra of a waterfall, and valves whose waterfalls are held while no page shows them.
FALL, MOST_FALLS = 120, 16
#: Streams that may be open.
MOST_STREAMS = 64

_STREAM_HEADERS = [
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


@dataclass(frozen=True, slots=True)
class Application:
    """What uvicorn runs, and its streams."""

    asgi: Starlette
    streams: Streams


def application(desk: Desk) -> Application:
    """Return the application that shows what lies on ``desk``."""
    pages, streams, operating, records = (
        Pages(desk),
        Streams(desk),
        Operating(desk),
        Records(desk, language_for),
    )
    routes = [
        Route("/", pages.machine),
        Route("/alarms", pages.alarms),
        Route("/history", pages.history),
        Route("/valve/{name:path}", pages.valve),
        Route("/static/{name:path}", pages.file),
        Route("/language/{code}", pages.language),
        Route("/stream/machine", streams.machine),
        Route("/stream/valve/{name:path}", streams.valve),
        Route("/trend", records.trend),
        Route("/sparks", records.sparks),
        Route("/history.json", records.history),
        Route("/history.csv", records.history_table),
        Route("/gap", records.gap),
        Route("/operator", operating.check, methods=["POST"]),
        Route("/act", operating.act, methods=["POST"]),
        Route("/acts", operating.acts, methods=["POST"]),
    ]
    if desk.metrics is not None:
        routes.append(Route("/metrics", desk.metrics.answer))
    return Application(Starlette(routes=routes, middleware=[Middleware(Guard)]), streams)


class Guard:
    """Refuses names that are not this host's (DNS rebinding), other origins, and too many requests."""

    def __init__(self, app: ASGIApp, limit: RateLimit | None = None) -> None:
        self._app = app
        self._limit = limit or RateLimit(RATE, BURST)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it (ASGI)."""
        if scope["type"] != "http":
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_HEADERS]
            await send(message)

        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, guarded)
        else:
            await self._app(scope, receive, guarded)

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        if not self._limit.take():
            return PlainTextResponse("too many requests", 429, {"retry-after": "2"})
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not own_host(hosts[0]):
            return PlainTextResponse("open this page by an IP address or localhost", 421)
        origins = headers.getlist("origin")
        if len(origins) > 1 or any(not same_origin(origin, hosts[0]) for origin in origins):
            return PlainTextResponse("requests from other pages are refused", 403)
        site = headers.get("sec-fetch-site", "none")
        opened = scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if site not in ("same-origin", "none") and not opened:
            return PlainTextResponse("requests from other pages are refused", 403)
        if scope["method"] == "POST" and not origins:
            return PlainTextResponse("the Origin header is missing", 403)
        return None


def own_host(host: str) -> bool:
    """Return whether ``host`` (with port) is localhost or an IP address, no name that others resolve."""
    if not host or len(host) > 100 or any(mark in host for mark in "/\\@?#% \t"):
        return False
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port  # raises where it is none
        if parts.hostname != "localhost":
            ipaddress.ip_address(parts.hostname or "")
    except ValueError:
        return False
    return True


def same_origin(origin: str, host: str) -> bool:
    """Return whether ``origin`` is the page's own, as reached by ``host``."""
    return origin.lower() == f"http://{host.lower()}"


class Pages:
    """Pages of the site in its languages, and its files."""

    def __init__(self, desk: Desk) -> None:
        self._texts: dict[str, dict[str, Any]] = {
            language: json.loads(SITE.joinpath(f"texts_{language}.json").read_text(encoding="utf-8"))
            for language in LANGUAGES
        }
        environment = Environment(loader=BaseLoader(), autoescape=True, undefined=StrictUndefined)
        self._template = environment.from_string(SITE.joinpath("page.html").read_text(encoding="utf-8"))
        self._files = {**_files(SITE), **_files(CHARTS)}
        self._operable = desk.operable

    async def machine(self, request: Request) -> Response:
        """Answer with the machine's page."""
        return self._page(request, "machine")

    async def alarms(self, request: Request) -> Response:
        """Answer with the page of all alarms."""
        return self._page(request, "alarms")

    async def history(self, request: Request) -> Response:
        """Answer with the page of the journals."""
        return self._page(request, "history")

    async def valve(self, request: Request) -> Response:
        """Answer with a valve's page."""
        name = request.path_params["name"]
        if len(name) > 200 or not VALVE.fullmatch(name):
            return PlainTextResponse("no such page", 404)
        return self._page(request, "valve", name)

    async def file(self, request: Request) -> Response:
        """Answer with a file of the site."""
        found = self._files.get(request.path_params["name"])
        if found is None:
            return PlainTextResponse("no such file", 404)
        content, kind, tag = found
        headers = {"cache-control": "no-cache", "etag": tag}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=kind, headers=headers)

    async def language(self, request: Request) -> Response:
        """Remember the language that is asked for, and go back."""
        code, back = request.path_params["code"], request.query_params.get("to", "/")
        if code not in LANGUAGES or not _OWN_PAGE.fullmatch(back):
            return PlainTextResponse("no such language", 404)
        answer = RedirectResponse(back, 303)
        answer.set_cookie(COOKIE, code, max_age=31_536_000, samesite="strict", httponly=True)
        return answer

    def _page(self, request: Request, view: str, valve: str = "") -> Response:
        language = language_for(request)
        text = self._template.render(
            texts=self._texts[language],
            language=language,
            languages={code: self._texts[code]["language_name"] for code in LANGUAGES},
            view=view,
            valve=valve,
            here=request.url.path,
            operable=self._operable,
        )
        headers = {"cache-control": "no-store", "vary": "accept-language, cookie"}
        return Response(text, media_type="text/html", headers=headers)


def language_for(request: Request) -> str:
    """Return the language of the page that ``request`` is answered with."""
    return language_of(request.cookies.get(COOKIE, ""), request.headers.get("accept-language", ""))


def language_of(chosen: str, accepted: str) -> str:
    """Return the language that was chosen, else the best of ``accepted`` (RFC 9110, 12.5.4) that there is."""
    if chosen in LANGUAGES:
        return chosen
    wishes = []
    for part in accepted[:500].split(","):
        name, _, rest = part.strip().partition(";")
        try:
            weight = float(rest.strip().removeprefix("q=") or 1.0)
        except ValueError:
            weight = 0.0
        wishes.append((weight, name.partition("-")[0].lower()))
    wishes.sort(key=lambda wish: -wish[0])
    return next((name for weight, name in wishes if name in LANGUAGES and weight > 0.0), LANGUAGES[0])


class ServerThread:
    """Server of ``application`` on ``own``, which is bound already."""

    def __init__(self, application: Application, own: socket.socket) -> None:
        self._application, self._socket = application, own
        config = uvicorn.Config(
            application.asgi, http=PageProtocol, ws="none", lifespan="off", loop="asyncio",
            log_config=None, access_log=False, server_header=False, proxy_headers=False,
            limit_concurrency=MOST_CONNECTIONS, backlog=128, timeout_keep_alive=5,
            timeout_graceful_shutdown=GRACE, h11_max_incomplete_event_size=16_384,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="page", daemon=True)
        self._begun = threading.Event()

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()
        self._begun.wait(5.0)

    def stop(self) -> None:
        """End every stream and connection; returns within about a second."""
        self._server.should_exit = True
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._application.streams.close)
        self._thread.join(GRACE + 0.5)
        if self._thread.is_alive():
            self._server.force_exit = True
            self._thread.join(0.5)

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        steps = asyncio.ensure_future(self._application.streams.run())
        self._begun.set()
        try:
            # A copy: uvicorn closes what it is given, the node may be activated again.
            await self._server.serve(sockets=[self._socket.dup()])
        finally:
            steps.cancel()


class Streams:
    """Streams of one server."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._machine = MachineChannel(desk)
        self._valves: dict[str, ValveChannel] = {}
        self._falls: OrderedDict[str, deque[list[float]]] = OrderedDict()
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
                    self._desk.warn(f"a change could not be sent: {unexpected(error)}")

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
            self._valves.setdefault(name, ValveChannel(self._desk, name, self._fall(name))).join(reader)

        def leave(reader: Reader) -> None:
            channel = self._valves.get(name)
            if channel is not None:
                channel.leave(reader)
                if not channel.readers:
                    del self._valves[name]

        return self._stream(request, join, leave)

    def _fall(self, name: str) -> deque[list[float]]:
        """Return the spectra of the valve ``name`` that were shown last, for a page that is opened again."""
        fall = self._falls.setdefault(name, deque(maxlen=FALL))
        self._falls.move_to_end(name)
        while len(self._falls) > MOST_FALLS:
            self._falls.popitem(last=False)
        return fall

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
        self._alarms: dict[str, list[dict[str, Any]]] = {}
        self._heard: dict[str, object] = {}  # messages that the alarms were made of
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
        for name, valve in list(self._desk.valves.items()):
            seen = (valve.changes, valve.condition(now))
            if self._seen.get(name) == seen:
                continue
            self._seen[name] = seen
            row = row_of(valve, now)
            if self._rows.get(name) != row:
                self._rows[name] = row
                rows.append(row)
            message = valve.alarms
            if self._heard.get(name) is not message:
                self._heard[name], listed = message, alarms_of(message)
                if self._alarms.get(name, []) != listed:
                    self._alarms[name] = alarms[name] = listed
        if (rows or alarms) and self.readers:
            event = encode("machine", {"whole": False, "rows": rows, "alarms": alarms})
            for reader in tuple(self.readers):
                reader.offer(event)


class ValveChannel:
    """Valve's channel: its view where it changed, and its spectrum."""

    def __init__(self, desk: Desk, name: str, fall: deque[list[float]]) -> None:
        self._desk, self._name, self._fall = desk, name, fall
        self.readers: set[Reader] = set()
        self._detail: dict[str, Any] = {}
        self._seen: tuple[int, str] | None = None
        self._event = b""
        self._newest: bytes | None = None

    def join(self, reader: Reader) -> None:
        """Give ``reader`` all there is, and what changes from now on."""
        self.step()
        reader.offer(self._event)
        if self._fall:
            reader.offer(encode("waterfall", {"spool": list(self._fall)}))
        if not self.readers:
            self._desk.open.append(self._name)
        self.readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Take note that ``reader`` is gone."""
        if reader in self.readers:
            self.readers.discard(reader)
            if not self.readers:
                self._desk.open.remove(self._name)

    def step(self) -> None:
        """Send what changed."""
        valve, now = self._desk.valves.get(self._name) or HeardValve(self._name), time.monotonic()
        events = []
        seen = (valve.changes, valve.condition(now))
        if seen != self._seen:
            self._seen, detail = seen, detail_of(valve, now)
            if detail != self._detail:
                self._detail, self._event = detail, encode("valve", detail)
                events.append(self._event)
        blocks = list(valve.blocks)
        if self.readers and blocks and blocks[-1] is not self._newest:
            self._newest = blocks[-1]
            found = self._desk.spectrum(blocks)
            if found is not None:
                self._fall.append(found["spool"])
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


def _files(folder: Path) -> dict[str, tuple[bytes, str, str]]:
    """Return content, type and tag of every file for browsers below ``folder``, by its path there."""
    found = {}
    for path in sorted(folder.rglob("*")):
        kind = _TYPES.get(path.suffix)
        if kind is not None:
            content = path.read_bytes()
            tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[path.relative_to(folder).as_posix()] = (content, kind, tag)
    return found


class _EventStream(Response):
    """Response that sends what a reader is offered until one side ends it."""

    def __init__(self, reader: Reader, join: Callable[[], None], left: Callable[[], None]) -> None:
        super().__init__()
        self._reader, self._join, self._left = reader, join, left

    async def __call__(self, _scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream (ASGI)."""
        gone = asyncio.ensure_future(self._watch(receive))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": _STREAM_HEADERS})
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
