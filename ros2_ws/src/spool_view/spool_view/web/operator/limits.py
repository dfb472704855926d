"""Limits of rates: so many at once, so many a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(slots=True)
class RateLimit:
    """Rate limit: ``burst`` at once, refilled by ``rate`` a second (token bucket)."""

    rate: float
    burst: float
    clock: Callable[[], float] = time.monotonic
    _left: float = field(init=False)
    _last: float = field(init=False)

    def __post_init__(self) -> None:
        self._left, self._last = self.burst, self.clock()

    def take(self) -> bool:
        """Return whether one more is within the limit, and count it if so."""
        now = self.clock()
        self._left = min(self.burst, self._left + self.rate * (now - self._last))
        self._last = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True
