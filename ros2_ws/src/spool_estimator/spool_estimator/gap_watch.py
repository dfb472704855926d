"""Whether what the online model leaves over grows beyond what it usually leaves: the model gap, live."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from statistics import median

from spool_stream.quantity import Quantity

from .estimate import Estimate, State

#: Estimates from which the floor is learned.
LEARNED = 20
#: Estimates in a row that decide.
IN_A_ROW = 3
#: Deviations above the floor that an estimate must reach, too, and the smallest deviation over the floor.
DEVIATIONS, LEAST_DEVIATION = 6.0, 0.05
#: Standard deviation of normal numbers over their median deviation.
NORMAL = 1.4826
#: Share of the way from the floor to the limit below which the gap has closed again.
CLOSED = 0.5


@dataclass(frozen=True, slots=True)
class GapChange:
    """The gap opened or closed.

    Attributes:
        stamp: ns.
        raised: it opened.
        residual: at that time, relative.
        floor: what is usual, relative.
    """

    stamp: int
    raised: bool
    residual: Quantity
    floor: float

    @property
    def sentence(self) -> str:
        """Return one line for people."""
        now, usual = f"{100.0 * self.residual.value:.3g} %", f"{100.0 * self.floor:.3g} %"
        if self.raised:
            return f"the model leaves {now} of the force unexplained, usually {usual}: something is missing"
        return f"the model explains the motion again: {now} is left, usually {usual}"


@dataclass(slots=True)
class GapWatch:
    """Learn what the model usually leaves over, and say when that grows.

    The floor is the median of the first ``LEARNED`` residuals while the estimator tracks; whatever is not
    tracked says nothing.

    Attributes:
        growth: residual over the floor from which the gap is open.
        raised: it is open.
        floor: learned, relative; ``None`` while it is being learned.
        limit: residual above which the gap opens.
    """

    growth: float = 1.5
    raised: bool = field(default=False, init=False)
    floor: float | None = field(default=None, init=False)
    limit: float = field(default=0.0, init=False)
    _first: list[float] = field(default_factory=list, init=False)
    _last: deque[float] = field(default_factory=lambda: deque(maxlen=IN_A_ROW), init=False)

    def update(self, estimate: Estimate) -> GapChange | None:
        """Take an estimate; return what changed with it."""
        if estimate.state is not State.TRACKING or not estimate.residual.known:
            return None
        value = estimate.residual.value
        if self.floor is None:
            self._learn(value)
            return None
        self._last.append(value)
        if len(self._last) < IN_A_ROW:
            return None
        closed = self.floor + CLOSED * (self.limit - self.floor)
        opens = not self.raised and min(self._last) > self.limit
        closes = self.raised and max(self._last) < closed
        if not (opens or closes):
            return None
        self.raised = opens
        return GapChange(estimate.stamp, opens, estimate.residual, self.floor)

    def _learn(self, value: float) -> None:
        self._first.append(value)
        if len(self._first) < LEARNED:
            return
        floor = median(self._first)
        deviation = NORMAL * median(abs(one - floor) for one in self._first)
        deviation = max(deviation, LEAST_DEVIATION * floor)
        self.limit = max(self.growth * floor, floor + DEVIATIONS * deviation)
        self.floor = floor
        self._first.clear()
