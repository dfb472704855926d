"""Recent counts: what a stream lost and refused within the last minute of its data."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

#: s of data that are looked back on.
RECENT = 60.0


@dataclass(slots=True)
class RecentCounts:
    """Recent counts of blocks lost and refused in RECENT s, by steps of 1 s; its user advances the clock."""

    lost: int = 0
    refused: int = 0
    _clock: float = 0.0
    _steps: deque[list[int]] = field(default_factory=deque)

    def advance(self, seconds: float) -> None:
        """Let time go on; what is older than RECENT is forgotten."""
        self._clock += seconds
        while self._steps and self._steps[0][0] < self._clock - RECENT:
            _, lost, refused = self._steps.popleft()
            self.lost -= lost
            self.refused -= refused

    def count(self, lost: int, refused: int) -> None:
        """Take note of blocks that were lost or refused now."""
        now = int(self._clock)
        if not self._steps or self._steps[-1][0] != now:
            self._steps.append([now, 0, 0])
        self._steps[-1][1] += lost
        self._steps[-1][2] += refused
        self.lost += lost
        self.refused += refused
