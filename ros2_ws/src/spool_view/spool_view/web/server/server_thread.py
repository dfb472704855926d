"""Server in a thread of its own: begins with the node's activation, ends with all streams open."""

from __future__ import annotations

import asyncio
import socket
import threading

import uvicorn

from .application import Application
from .connections import PageProtocol

#: Connections that may be open; s that requests under way get at the end.
MOST_CONNECTIONS, GRACE = 256, 1


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
        self._thread = threading.Thread(target=self._work, name="page", daemon=True)
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

    def _work(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        steps = asyncio.ensure_future(self._application.streams.run())
        self._begun.set()
        try:
            # A copy: uvicorn closes what it is given, the node may be activated again.
            await self._server.serve(sockets=[self._socket.dup()])
        finally:
            steps.cancel()
