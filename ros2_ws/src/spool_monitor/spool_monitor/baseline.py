"""Baseline of a parameter: how it is learned, and the record that is kept of it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError

#: s, estimates do not come closer; it bounds how many are kept for a start value.
SHORTEST_PERIOD = 0.1


@dataclass(frozen=True, slots=True)
class HealthyValue:
    """Start value of one parameter of the healthy valve, in ``unit``, as it is kept.

    ``value`` is what is compared with (the median), ``spread`` the robust standard deviation around it;
    ``mean`` and ``standard_deviation`` are those of the ``count`` valid estimates. ``correlation`` is that of
    neighbouring ones (NaN: not determined), without which no false-alarm rate can be stated. ``referred``
    says that it holds at one oil temperature; at ``temperature`` (deg C, NaN: not measured) it was learned.
    ``sensitivity`` is that to a gain error between the accelerometers then (NaN: not known).
    """

    name: str
    unit: str
    value: float
    spread: float
    mean: float
    standard_deviation: float
    count: int
    correlation: float = math.nan
    referred: bool = False
    temperature: float = math.nan
    sensitivity: float = math.nan


@dataclass(slots=True)
class Baseline:
    """Baseline of one parameter: its start value, the median of the valid estimates of ``duration`` s,
    three at least.

    Each estimate counts for the shortest time between two, so that standstills do not count. ``value`` and
    ``spread`` (robust standard deviation) are NaN while it is being learned, and so are ``mean`` and
    ``deviation`` of the ``count`` estimates and ``correlation``, that of neighbours.
    """

    duration: float
    value: float = field(default=math.nan, init=False)
    spread: float = field(default=math.nan, init=False)
    mean: float = field(default=math.nan, init=False)
    deviation: float = field(default=math.nan, init=False)
    correlation: float = field(default=math.nan, init=False)
    count: int = field(default=0, init=False)
    _seen: list[float] = field(default_factory=list, init=False)
    _last: int | None = field(default=None, init=False)
    _period: float = field(default=math.inf, init=False)

    @property
    def frozen(self) -> bool:
        """Whether the start value is fixed."""
        return not math.isnan(self.value)

    def learn(self, stamp: int, value: float) -> None:
        """Take the estimate at ``stamp`` (ns) in, until there are enough of them."""
        if self.frozen:
            return
        if self._last is not None and stamp > self._last:
            self._period = min(self._period, max(SHORTEST_PERIOD, (stamp - self._last) * 1e-9))
        self._last = stamp
        self._seen.append(value)
        # Half a period less: stamps jitter.
        if len(self._seen) >= 3 and (len(self._seen) + 0.5) * self._period >= self.duration:
            self.value = float(np.median(self._seen))
            # 1.4826: median absolute deviation to standard deviation of a normal distribution.
            self.spread = 1.4826 * float(np.median(np.abs(np.array(self._seen) - self.value)))
            self._describe(np.array(self._seen))
            self._seen.clear()

    def restart(self) -> None:
        """Learn from here on; a fixed start value is forgotten."""
        self.value = self.spread = self.mean = self.deviation = self.correlation = math.nan
        self.count = 0
        self._seen.clear()

    def restore(self, kept: HealthyValue) -> None:
        """Go on with a start value that was learned before."""
        self.restart()
        self.value, self.spread = kept.value, kept.spread
        self.mean, self.deviation, self.correlation = (kept.mean, kept.standard_deviation, kept.correlation)
        self.count = kept.count

    def _describe(self, seen: NDArray[np.float64]) -> None:
        self.count, self.mean = seen.size, float(seen.mean())
        self.deviation = float(seen.std(ddof=1))
        around = seen - self.mean
        power = float(around @ around)
        self.correlation = float(around[1:] @ around[:-1]) / power if power > 0.0 else math.nan


class BaselineStage(enum.Enum):
    """Stage of a baseline: how far it has come."""

    LEARNED = "learned"  # complete and used, but nobody has confirmed it
    FROZEN = "frozen"  # confirmed: replaced by a newer version only


@dataclass(frozen=True, slots=True)
class BaselineRecord:
    """Baseline of a valve, complete.

    ``valve_id`` and ``oil`` (empty: not known) name what it was learned on, ``temperature`` the lowest and
    highest oil temperature met meanwhile (deg C, NaN: not measured), ``learned_at`` when (ns).
    ``who`` and ``comment`` are of the operator who froze it.
    """

    valve_id: str
    oil: str = ""
    temperature: tuple[float, float] = (math.nan, math.nan)
    version: int = 0
    stage: BaselineStage = BaselineStage.LEARNED
    learned_at: int = 0
    who: str = ""
    comment: str = ""
    values: tuple[HealthyValue, ...] = field(default=())

    def value(self, name: str) -> HealthyValue | None:
        """Return a parameter by its name, ``None`` where it was not learned."""
        return next((value for value in self.values if value.name == name), None)

    def check_valve(self, valve_id: str, oil: str) -> None:
        """Make sure that this is the baseline of that valve with that oil.

        Raises:
            InputError: it is another's; both are named. An unknown oil (empty) fits every one.

        """
        if valve_id != self.valve_id:
            raise InputError(
                f"baseline version {self.version} is of valve {self.valve_id}, not of {valve_id}: "
                "name that valve's state_folder, or learn again"
            )
        if oil and self.oil and oil != self.oil:
            raise InputError(
                f"baseline version {self.version} of {valve_id} was learned with {self.oil}, "
                f"the valve runs on {oil}: learn again"
            )

    def covers(self, celsius: float, margin: float = 5.0) -> bool:
        """Whether ``celsius`` lies in the temperature band, ``margin`` (deg C) wider; unknown ones do."""
        low, high = self.temperature
        return not (celsius < low - margin or celsius > high + margin)
