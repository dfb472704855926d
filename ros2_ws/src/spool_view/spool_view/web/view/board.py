"""Board of valves: the last of what was heard, of a bounded number of valves, shared by node and server."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

#: Valves that are held at most; the first ones heard stay.
MOST_VALVES = 1000
#: Blocks of samples that are held of a valve whose page is open; 4 s at 50 blocks/s.
MOST_BLOCKS = 200


@dataclass(slots=True)
class HeardValve:
    """Heard valve: its last messages and when the monitor's last word arrived (s, monotonic).

    ``estimate``, ``gap``, ``baseline`` and ``limits`` are looked at only while the valve's page is open.
    ``changes`` counts what came.
    """

    name: str
    health: Any = None
    health_at: float = 0.0
    estimate: Any = None
    alarms: tuple[dict[str, Any], ...] = ()
    gap: Any = None
    baseline: Any = None
    limits: dict[str, float] = field(default_factory=dict)
    blocks: deque[bytes] = field(default_factory=lambda: deque(maxlen=MOST_BLOCKS))
    changes: int = 0


class Board:
    """Board: written by the node's thread, read by the server's; each field is replaced, never changed."""

    def __init__(self) -> None:
        self.valves: dict[str, HeardValve] = {}
        #: How many browsers have a valve's page open.
        self.open: dict[str, int] = {}

    def join(self, name: str) -> HeardValve | None:
        """Return the valve ``name``, ``None`` where there are too many."""
        if name not in self.valves and len(self.valves) >= MOST_VALVES:
            return None
        return self.valves.setdefault(name, HeardValve(name))

    def opened(self, name: str) -> None:
        """Take note that a browser opened the page of ``name``."""
        self.open[name] = self.open.get(name, 0) + 1

    def closed(self, name: str) -> None:
        """Take note that a browser closed it."""
        left = self.open.get(name, 0) - 1
        if left > 0:
            self.open[name] = left
        else:
            self.open.pop(name, None)
