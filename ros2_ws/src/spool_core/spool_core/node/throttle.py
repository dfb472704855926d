"""Throttle of what a log says of something that may happen a hundred times a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

#: s between two lines about the same: an operator's log of a day holds 8640 at most.
PERIOD = 10.0


@dataclass(slots=True)
class Throttle:
    """Throttle: passes the first of a kind and then one in ``period`` s, with how many there were between.

    ``clock`` gives s of a steady clock.
    """

    period: float = PERIOD
    clock: Callable[[], float] = time.monotonic
    _kept_back: dict[str, int] = field(default_factory=dict)
    _said: dict[str, float] = field(default_factory=dict)

    def take(self, kind: str) -> int:
        """Return how many of ``kind`` to tell of now, this one included; 0: none."""
        now = self.clock()
        count = self._kept_back.get(kind, 0) + 1
        if kind in self._said and now - self._said[kind] < self.period:
            self._kept_back[kind] = count
            return 0
        self._said[kind], self._kept_back[kind] = now, 0
        return count
