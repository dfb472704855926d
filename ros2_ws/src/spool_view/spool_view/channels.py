"""Channels of the page: what browsers are sent of the machine and of a valve, and the readers of it."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from spool_monitor.listener import HeardValve

from spool_view.operator import Desk
from spool_view.view import WINDOW, alarms_of, detail_of, is_whole, row_of

#: s between two steps: chosen, a change shows later by that, and shorter costs each page more.
PERIOD = 0.5
#: Spectra of a waterfall: a minute.
FALL = 120
#: s between two spectra from which a waterfall shows a gap.
BROKEN = 3.0
#: Events that a reader may be behind (4 s), and bytes of them.
MOST_BEHIND, MOST_BYTES = 8, 2_000_000

#: Spectra of a waterfall with the times (s since 1970) at which their last samples came.
Fall = deque[tuple[float, list[float]]]


class Channel:
    """Channel with its readers."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self.readers: set[Reader] = set()

    def _send(self, *events: bytes) -> None:
        for event in events:
            for reader in tuple(self.readers):
                reader.offer(event)


class MachineChannel(Channel):
    """Machine's channel: rows and alarms that changed since the last step."""

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
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
        """Remove ``reader``, which is gone."""
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
            self._send(encode("machine", {"whole": False, "rows": rows, "alarms": alarms}))


class ValveChannel(Channel):
    """Valve's channel: its view where it changed, and its spectrum."""

    def __init__(self, desk: Desk, name: str, fall: Fall) -> None:
        super().__init__(desk)
        self._name, self._fall = name, fall
        self._detail: dict[str, Any] = {}
        self._seen: tuple[int, str] | None = None
        self._event = b""
        self._newest: bytes | None = None

    def join(self, reader: Reader) -> None:
        """Give ``reader`` all there is, and what changes from now on."""
        self.step()
        reader.offer(self._event)
        if self._fall:
            reader.offer(encode("waterfall", waterfall_of(self._fall, time.time())))
        if not self.readers:
            self._desk.open.append(self._name)
        self.readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Remove ``reader``, which is gone."""
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
                if is_whole(found):
                    self._fall.append((time.time(), found["spool"]))
                events.append(encode("spectrum", found))
        self._send(*events)


def waterfall_of(fall: Fall, now: float) -> dict[str, Any]:
    """Return a waterfall as browsers get it at ``now`` (s since 1970); an empty line where time is missing.

    ``until``: the time (s since 1970) at the last place where some is missing, ``None`` where none is.
    """
    lines: list[list[float]] = []
    last, until = math.inf, None
    for seconds, spool in (*fall, (now, None)):
        if seconds - last > BROKEN:
            lines.append([])
            until = int(last)
        if spool is not None:
            lines.append(spool)
        last = seconds
    return {"step": 1.0 / WINDOW, "spool": lines, "until": until}


def encode(event: str, data: Any) -> bytes:
    """Return a server-sent event (WHATWG HTML, 9.2)."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return f"event: {event}\ndata: {text}\n\n".encode("ascii")


class Reader:
    """A browser's open stream; ``drop`` ends its connection at once."""

    def __init__(self, drop: Callable[[], object]) -> None:
        self._drop = drop
        self._waiting: deque[bytes] = deque()
        self._news = asyncio.Event()
        self.ended = False

    def offer(self, event: bytes) -> None:
        """Hand over an event; a reader that is too far behind is dropped."""
        if self.ended:
            return
        self._waiting.append(event)
        size = sum(map(len, self._waiting))
        if len(self._waiting) > MOST_BEHIND or (size > MOST_BYTES and len(self._waiting) > 1):
            self.end()
            self._drop()
        self._news.set()

    def end(self) -> None:
        """End the stream after what is being sent."""
        self.ended = True
        self._waiting.clear()
        self._news.set()

    async def next(self) -> bytes | None:
        """Return all that waits, ``None`` at the end."""
        while not self._waiting and not self.ended:
            self._news.clear()
            await self._news.wait()
        if self.ended:
            return None
        events = b"".join(self._waiting)
        self._waiting.clear()
        return events
