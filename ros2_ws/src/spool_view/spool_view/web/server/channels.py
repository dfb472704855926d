"""Channels: the machine's view and that of each valve whose page is open, as changes for their readers."""

from __future__ import annotations

import time
from typing import Any

from spool_monitor.node.valve_condition import condition_of

from spool_view.web.view.board import HeardValve
from spool_view.web.view.detail import detail_of
from spool_view.web.view.machine import row_of

from .desk import Desk
from .readers import Reader, encode


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
