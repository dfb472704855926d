"""Connections: bounded buffers, a time for each request to come in, and a way to end one at once."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

#: s that the head of a request may take.
HEAD = 10.0
#: B that the system may hold for a reader that does not read.
SEND_BUFFER = 131_072

_OPEN: dict[tuple[str, int], asyncio.Transport] = {}


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
