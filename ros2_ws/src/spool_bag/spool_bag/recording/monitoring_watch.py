"""Supervision of the monitors: whose acceleration flows while nobody tells of its health."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

#: s between two messages of a monitor's health are 1: five that are missing are no jitter of a busy machine.
SILENT = 5.0
#: s that a monitor may take to start: kernels of several nodes may be compiled, one after the other.
STARTS = 180.0
#: s after which acceleration no longer counts as flowing.
FLOWS = 2.0


class Monitored(enum.Enum):
    """State of supervision of a valve; the value is the text people read."""

    YES = "monitored"
    NOT_YET = "not monitored yet: no health since data flow"
    NO = "not monitored"
    IDLE = "no data"


@dataclass(slots=True)
class _Heard:
    data: float | None = None
    since: float | None = None
    health: float | None = None


@dataclass(slots=True)
class MonitoringWatch:
    """Watchdog of the monitors: which valves nobody monitors, by what arrives of each; times in steady s."""

    _valves: dict[str, _Heard] = field(default_factory=dict)

    def saw_data(self, valve: str, now: float) -> None:
        """Take note of acceleration of ``valve``."""
        heard = self._valves.setdefault(valve, _Heard())
        if heard.data is None or now - heard.data > FLOWS:
            heard.since = now
        heard.data = now

    def saw_health(self, valve: str, now: float) -> None:
        """Take note of the health of ``valve``."""
        self._valves.setdefault(valve, _Heard()).health = now

    def states(self, now: float) -> dict[str, Monitored]:
        """Return the state of each valve that was heard of.

        A monitor that was heard and is silent is missed whether or not data flow: it tells of silence, too.
        """
        return {valve: self._state(heard, now) for valve, heard in self._valves.items()}

    @staticmethod
    def _state(heard: _Heard, now: float) -> Monitored:
        if heard.health is not None:
            return Monitored.NO if now - heard.health > SILENT else Monitored.YES
        if heard.data is None or heard.since is None or now - heard.data > FLOWS:
            return Monitored.IDLE
        if now - heard.since <= SILENT:
            return Monitored.IDLE
        return Monitored.NO if now - heard.since > STARTS else Monitored.NOT_YET
