"""Readers of streams: each event is encoded once for all, and who reads too slowly is dropped."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from typing import Any

#: Events that a reader may be behind (4 s), and bytes of them.
MOST_BEHIND, MOST_BYTES = 8, 2_000_000


def encode(event: str, data: Any) -> bytes:
    """Return a server-sent event (WHATWG HTML, 9.2)."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return f"event: {event}\ndata: {text}\n\n".encode("ascii")


class Reader:
    """Reader: a browser's open stream; ``drop`` ends its connection at once."""

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
