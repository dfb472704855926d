"""Application: every address that the page has."""

from __future__ import annotations

from dataclasses import dataclass

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.routing import Route

from .desk import Desk
from .guard import Guard
from .operating import Operating
from .pages import Pages
from .records import Records
from .streams import Streams


@dataclass(frozen=True, slots=True)
class Application:
    """Application: what uvicorn runs, and its streams."""

    asgi: Starlette
    streams: Streams


def application(desk: Desk) -> Application:
    """Return the application that shows what lies on ``desk``."""
    pages, streams, operating, records = Pages(desk), Streams(desk), Operating(desk), Records(desk)
    routes = [
        Route("/", pages.machine),
        Route("/valve/{name:path}", pages.valve),
        Route("/static/{name:path}", pages.file),
        Route("/language/{code}", pages.language),
        Route("/stream/machine", streams.machine),
        Route("/stream/valve/{name:path}", streams.valve),
        Route("/trend", records.trend),
        Route("/gap", records.gap),
        Route("/operator", operating.check, methods=["POST"]),
        Route("/act", operating.act, methods=["POST"]),
    ]
    return Application(Starlette(routes=routes, middleware=[Middleware(Guard)]), streams)
