"""Ticker: periodic callbacks of many nodes on one timer of a process that hosts them."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable


class Ticker:
    """Ticker whose :meth:`run` calls what is due; its host does that every :data:`STEP` s.

    The events executor looks through all timers of a clock at each of their turns, so that those of a hundred
    valves would cost more than what they do.
    """

    #: s, a fifth of the shortest period that a node asks for.
    STEP = 0.02

    def __init__(self) -> None:
        self._due: list[tuple[float, int, float, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._ended: set[int] = set()

    def every(self, period: float, callback: Callable[[], None]) -> Callable[[], None]:
        """Call back every ``period`` s from now on; return what ends it."""
        number = next(self._numbers)
        # Those that begin together are spread over the period.
        phase = (number * 0.618) % 1.0
        heapq.heappush(self._due, (time.monotonic() + phase * period, number, period, callback))
        return lambda: self._ended.add(number)

    def run(self) -> None:
        """Call what is due; what is late is called once."""
        now = time.monotonic()
        while self._due and self._due[0][0] <= now:
            due, number, period, callback = heapq.heappop(self._due)
            if number in self._ended:
                self._ended.discard(number)
                continue
            callback()
            later = due + period if due + period > now else now + period
            heapq.heappush(self._due, (later, number, period, callback))
