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
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Awaitable, Callable
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import uvicorn
from jinja2 import BaseLoader, Environment, StrictUndefined
from spool_core.faults import unexpected
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from spool_view.acts import RateLimit
from spool_view.channels import FALL, PERIOD, Fall, MachineChannel, Reader, ValveChannel, encode
from spool_view.kept import Records
from spool_view.operator import Desk, Operating

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

#: s between two signs of life: what a page does not hear it does not believe.
BEAT = 2.0
#: Valves whose waterfalls are held while no page shows them, and streams that may be open.
MOST_FALLS, MOST_STREAMS = 16, 64

_STREAM = "text/event-stream; charset=utf-8"
_STREAM_HEADERS = {"x-accel-buffering": "no"}

#: s that the head of a request may take, of a kept connection twice that, and s that a client may not read.
HEAD, STALLED = 10.0, 20.0
#: B that the system may hold for a reader that does not read: chosen, it bounds the memory.
SEND_BUFFER = 131_072

_OPEN: dict[Any, PageProtocol] = {}


class Application(NamedTuple):
    """What uvicorn runs, and its streams."""

    asgi: Starlette
    streams: Streams


def application(desk: Desk) -> Application:
    """Return the application that shows what lies on ``desk``."""
    pages, streams, operating = Pages(desk), Streams(desk), Operating(desk)
    records = Records(desk, language_for)
    routes = [
        Route("/", pages.page("machine")),
        *(Route(f"/{view}", pages.page(view)) for view in ("alarms", "history")),
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
                own = message.get("headers", [])
                # A browser keeps what says so itself, the files of the site.
                unkept = () if b"cache-control" in dict(own) else ((b"cache-control", b"no-store"),)
                message["headers"] = [*own, *unkept, *_HEADERS]
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
        foreign = len(origins) > 1 or any(not same_origin(origin, hosts[0]) for origin in origins)
        site = headers.get("sec-fetch-site", "none")
        opened = scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if foreign or (site not in ("same-origin", "none") and not opened):
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
        self._personal = desk.token is not None and desk.token.personal

    def page(self, view: str) -> Callable[[Request], Awaitable[Response]]:
        """Return what answers with the page ``view`` of all valves."""
        return partial(self._page, view=view)

    async def valve(self, request: Request) -> Response:
        """Answer with a valve's page."""
        name = request.path_params["name"]
        if len(name) > 200 or not VALVE.fullmatch(name):
            return PlainTextResponse("no such page", 404)
        return await self._page(request, "valve", name)

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

    async def _page(self, request: Request, view: str, valve: str = "") -> Response:
        language = language_for(request)
        text = self._template.render(
            texts=self._texts[language],
            language=language,
            languages={code: self._texts[code]["language_name"] for code in LANGUAGES},
            view=view,
            valve=valve,
            here=request.url.path,
            operable=self._operable,
            personal=self._personal,
        )
        headers = {"vary": "accept-language, cookie"}
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
        """Begin to serve; who connects from now on is answered."""
        self._socket.listen(self._server.config.backlog)
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
        self._falls: OrderedDict[str, Fall] = OrderedDict()
        self._readers: set[Reader] = set()
        self._closed = False
        self._trouble = 0.0

    async def run(self) -> None:
        """Send what changes until it is cancelled; an error in one step is reported and does not end it."""
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
                    sign = encode("beat", {"now": time.time()})
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
            channel = self._valves.get(name)
            if channel is None:
                channel = self._valves[name] = ValveChannel(self._desk, name, self._fall(name))
            channel.join(reader)

        def leave(reader: Reader) -> None:
            channel = self._valves.get(name)
            if channel is not None:
                channel.leave(reader)
                if not channel.readers:
                    del self._valves[name]

        return self._stream(request, join, leave)

    def _fall(self, name: str) -> Fall:
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
        reader = Reader(lambda: abort(request.client))

        async def events() -> AsyncIterator[bytes]:
            self._readers.add(reader)
            try:
                yield b"retry: 2000\n\n"
                join(reader)
                while (found := await reader.next()) is not None:
                    yield found
            finally:
                self._readers.discard(reader)
                leave(reader)

        return StreamingResponse(events(), headers=_STREAM_HEADERS, media_type=_STREAM)


class PageProtocol(H11Protocol):
    """Connection of the page; a client that sends half a request or stops reading costs this one only."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it up; of too many, the oldest without a request of the host that has most such ends."""
        super().connection_made(transport)
        own = transport.get_extra_info("socket")
        if own is not None:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            # Else each answer on a kept connection waits 40 ms for an acknowledgement of its head.
            own.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        transport.set_write_buffer_limits(0)
        idle = [client for client, one in _OPEN.items() if one.idle]
        if len(_OPEN) >= MOST_CONNECTIONS - 1 and idle:
            (most, _), *_ = Counter(host for host, _ in idle).most_common(1)
            abort(next(client for client in idle if client[0] == most))
        if self.client is not None:
            _OPEN[self.client] = self
        self._last: object = None
        self._late = self._stuck = self.loop.call_later(HEAD, self._end_if_silent)

    @property
    def idle(self) -> bool:
        """Whether no request is under way."""
        cycle: Any = self.cycle  # None before the first request, whatever its type says
        return cycle is None or bool(cycle.response_complete)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection that ended."""
        self._late.cancel()
        self._stuck.cancel()
        _OPEN.pop(self.client, None)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Give the client time to read."""
        super().pause_writing()
        self._stuck = self.loop.call_later(STALLED, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the timer of a stalled client, which reads again."""
        super().resume_writing()
        self._stuck.cancel()

    def _end_if_silent(self) -> None:
        """End it where the request after the last one did not come."""
        if self.idle and self.cycle is self._last:
            self.transport.abort()
        self._last = self.cycle if self.idle else self
        self._late = self.loop.call_later(HEAD, self._end_if_silent)


def abort(client: Any) -> None:
    """End the connection of ``client`` (address and port) at once, whatever it has not read."""
    connection = _OPEN.pop(tuple(client), None) if client else None
    if connection is not None:
        connection.transport.abort()


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
