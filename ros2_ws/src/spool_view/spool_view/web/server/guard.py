"""Guard before every route: who may ask from where, how often, and what browsers may do with the answers."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from spool_view.web.operator.limits import RateLimit

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


class Guard:
    """Guard: refuses names that are not this host's (DNS rebinding), other origins, and too many requests."""

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
            return PlainTextResponse("this page answers to an IP address or localhost only", 421)
        origins = headers.getlist("origin")
        if len(origins) > 1 or any(not same_origin(origin, hosts[0]) for origin in origins):
            return PlainTextResponse("not from another page", 403)
        site = headers.get("sec-fetch-site", "none")
        opened = scope["method"] == "GET" and headers.get("sec-fetch-mode") == "navigate"
        if site not in ("same-origin", "none") and not opened:
            return PlainTextResponse("not from another page", 403)
        if scope["method"] == "POST" and not origins:
            return PlainTextResponse("say from which page (Origin)", 403)
        return None


def own_host(host: str) -> bool:
    """Return whether ``host`` (with port) is localhost or an IP address, no name that others resolve."""
    name = _split(host)
    if name is None:
        return False
    if name == "localhost":
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def same_origin(origin: str, host: str) -> bool:
    """Return whether ``origin`` is the page's own, as reached by ``host``."""
    return origin.lower() == f"http://{host.lower()}"


def _split(host: str) -> str | None:
    """Return the name in ``host`` without its port, ``None`` where it is none."""
    if not host or len(host) > 100 or any(mark in host for mark in "/\\@?#% \t"):
        return None
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return None
    return parts.hostname
