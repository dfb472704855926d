"""Drift of a parameter against the value the valve had when it was healthy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from spool_estimator.estimate import Estimate, State
from spool_stream.quantity import Quantity, Validity

from .event import Condition, Event, Severity

#: Standard deviations that a change must exceed before its size is judged at all.
SIGNIFICANCE = 4.0

#: The parameter that follows the oil's temperature.
VISCOUS = "viscous_coefficient"

#: s, estimates do not come closer; it bounds how many are kept for a start value.
SHORTEST_PERIOD = 0.1


@dataclass(slots=True)
class Baseline:
    """Start value of one parameter: median of the valid estimates of ``duration`` s, three at least.

    Each estimate counts for the shortest time between two, so that standstills do not count. ``value`` and
    ``spread`` (robust standard deviation) are NaN while it is being learned.
    """

    duration: float
    value: float = field(default=math.nan, init=False)
    spread: float = field(default=math.nan, init=False)
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
            self._seen.clear()

    def restart(self) -> None:
        """Learn from here on; a fixed start value is forgotten."""
        self.value = self.spread = math.nan
        self._seen.clear()


@dataclass(slots=True)
class DriftDetector:
    """Compare one parameter of each estimate with its baseline.

    Where the estimates carry it, the viscous coefficient is compared as referred to one oil temperature; a
    start value learned so is never compared with one at any other.

    ``warning`` and ``alarm`` are changes, relative to the baseline or absolute (``relative``); below
    ``deadband`` times the warning it clears. ``kind`` names the event, ``causes`` those of a fall and a rise.
    """

    parameter: str
    kind: str
    warning: float
    alarm: float
    relative: bool
    causes: tuple[str, str]
    baseline: Baseline
    deadband: float = 0.7
    on_delay: float = 2.0
    off_delay: float = 3.0
    referred: bool = field(default=False, init=False)
    change: Quantity = field(init=False)
    condition: Condition = field(init=False)

    def __post_init__(self) -> None:
        self.condition = Condition(self.kind, self.on_delay, self.off_delay, self.parameter)
        self.change = Quantity(f"{self.parameter}_change", "1")

    def update(self, estimate: Estimate) -> list[Event]:
        """Judge ``estimate``; return the event that follows, if any. Held parameters are not judged."""
        quantity = estimate.parameter(self.parameter)
        if estimate.state is not State.TRACKING or quantity.validity is not Validity.VALID:
            return []
        if self.parameter == VISCOUS:
            at_reference = estimate.referred_viscous_coefficient
            if at_reference.known and not self.referred and not self.baseline.frozen:
                self.baseline.restart()
                self.referred = True
            if self.referred:
                if at_reference.validity is not Validity.VALID:
                    return []
                quantity = at_reference
        if not self.baseline.frozen:
            self.baseline.learn(estimate.stamp, quantity.value)
            return []
        reference = self.baseline.value
        unit = "1" if self.relative else quantity.unit
        size = abs(reference) if self.relative else 1.0
        change = (quantity.value - reference) / size
        deviation = math.hypot(quantity.standard_deviation, self.baseline.spread) / size
        self.change = Quantity(f"{self.parameter}_change", unit, change, deviation, Validity.VALID)
        indicated = None
        if abs(change) >= self.warning and abs(change) > SIGNIFICANCE * deviation:
            indicated = Severity.ALARM if abs(change) >= self.alarm else Severity.WARNING
        text = f"{quantity.name.replace('_', ' ')} {quantity.value:.4g} {quantity.unit}, was {reference:.4g}"
        return self.condition.judge(
            estimate.stamp,
            indicated,
            released=abs(change) < self.deadband * self.warning,
            cause=self.causes[0] if change < 0.0 else self.causes[1],
            quantity=self.change,
            message=text,
        )
