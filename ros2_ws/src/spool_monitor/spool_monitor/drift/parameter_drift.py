"""Drift of a parameter: sequential test against the value that it had when the valve was healthy."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from spool_core.text import change, duration
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.events.event import Severity
from spool_monitor.signals.sequential import CumulativeSum, threshold_for

from .baseline import Baseline
from .outlook import Outlook

#: Standard deviations that a change must exceed before its size is judged at all.
SIGNIFICANCE = 4.0

#: The parameter that follows the oil's temperature.
VISCOUS = "viscous_coefficient"

#: Of the change that must be found: what is let pass for ever, what a single value counts for at most, below
#: what it is over, and above what uncertainty nothing is judged.
ALLOWANCE, CAP, RELEASE, UNCERTAIN = 0.65, 2.5, 0.45, 0.35

#: Changes that warn which make an alarm.
ALARMS = 2.0

#: s of a shift: what reaches its limit sooner is not to be planned but done.
SHIFT = 8.0 * 3600.0

#: s, what the sum needs at least: a change that just matters takes 8.6 s from when the estimate shows it.
SHORTEST_SUM = 3.0

#: s, time constant over which the change that is shown is smoothed.
SMOOTHING = 3.0

#: 1/K, relative error of an oil's law per degree away from where the start value was learned.
LAW_ERROR = 0.002


@dataclass(slots=True)
class ParameterDrift:
    """Drift test of one parameter: each estimate against its baseline.

    Where the estimates carry it, the viscous coefficient is compared as referred to one oil temperature; a
    start value learned so is never compared with one at any other. Not judged is what is held, what is too
    uncertain, and what ``update`` is told to distrust.

    ``matters`` is the change that must be found, relative to the baseline or absolute (``relative``).
    ``run_length`` is the mean time, s, to a false alarm that the spread of the baseline may cause.

    Attributes:
        tolerance: what is let pass on top, in units of the change that matters.
        change: of the parameter, smoothed, with its standard deviation.
        quantity: the parameter as it was compared last.
        level: ``None`` while the sum is below its threshold.
        released: whether the change is small enough to be over.
        since: when the change most likely began, ns; 0 where there is none.
        judged: whether the last estimate was.

    """

    parameter: str
    matters: float
    relative: bool
    baseline: Baseline
    run_length: float = 3.6e6
    tolerance: float = field(default=0.0, init=False)
    referred: bool = field(default=False, init=False)
    temperature: float = field(default=math.nan, init=False)
    sum: CumulativeSum = field(init=False)
    change: Quantity = field(init=False)
    quantity: Quantity = field(init=False)
    level: Severity | None = field(default=None, init=False)
    released: bool = field(default=False, init=False)
    judged: bool = field(default=False, init=False)
    _smoothed: float = field(default=math.nan, init=False)
    _variance: float = field(default=math.nan, init=False)
    _last: int = field(default=0, init=False)
    _memory: float = field(default=math.nan, init=False)
    _outlook: Outlook = field(default_factory=Outlook, init=False)

    def __post_init__(self) -> None:
        self.sum = CumulativeSum(ALLOWANCE, CAP)
        # Of what is judged in its own unit there is one, a force.
        self.change = Quantity(f"{self.parameter}_change", "1" if self.relative else "N")
        self.quantity = Quantity(self.parameter, "")

    @property
    def since(self) -> int:
        """When the change most likely began, ns; 0 where there is none."""
        return self.sum.since

    @property
    def share(self) -> float:
        """The smoothed change in units of the one that matters; 0 while unknown."""
        return 0.0 if math.isnan(self._smoothed) else self._smoothed

    def reset(self) -> None:
        """Forget the sum: what went before may not be believed."""
        self.sum.reset()
        self._outlook.reset()
        self.level = None
        self.released = False
        self._smoothed = math.nan

    def update(self, estimate: Estimate, *, distrust: bool = False) -> None:
        """Take ``estimate``; parameters that are held are not judged."""
        self.judged = False
        quantity = self._comparable(estimate)
        if distrust:
            self.reset()
            return
        if quantity is None:
            return
        reference = self.baseline.value
        size = self.matters * (abs(reference) if self.relative and self.baseline.frozen else 1.0)
        if self.relative and not self.baseline.frozen:
            size = self.matters * abs(quantity.value)
        if not quantity.standard_deviation <= UNCERTAIN * size:
            return
        celsius = estimate.oil_temperature.value
        if not self.baseline.frozen:
            self.baseline.learn(estimate.stamp, quantity.value)
            self.temperature = celsius if math.isnan(self.temperature) else self.temperature
            return
        seconds = (estimate.stamp - self._last) * 1e-9
        self._last = estimate.stamp
        if not 0.0 < seconds <= 3.0:
            seconds = 0.0
        self._judge(estimate, quantity, size, seconds, abs(celsius - self.temperature))

    def _comparable(self, estimate: Estimate) -> Quantity | None:
        """Return what is compared with the baseline, ``None`` where nothing can be."""
        quantity = estimate.parameter(self.parameter)
        if estimate.state is not State.TRACKING or quantity.validity is not Validity.VALID:
            return None
        if self.parameter != VISCOUS:
            return quantity
        at_reference = estimate.referred_viscous_coefficient
        if at_reference.known and not self.referred and not self.baseline.frozen:
            self.baseline.restart()
            self.referred = True
        if not self.referred:
            return quantity
        return at_reference if at_reference.validity is Validity.VALID else None

    def _judge(
        self, estimate: Estimate, quantity: Quantity, size: float, seconds: float, warmer: float
    ) -> None:
        self.judged = True
        self.quantity = quantity
        change = float(quantity.value - self.baseline.value) / size
        deviation = math.hypot(quantity.standard_deviation, self.baseline.spread) / size
        if math.isnan(self._smoothed):
            self._smoothed = change
        self._smoothed += (1.0 - math.exp(-seconds / SMOOTHING)) * (change - self._smoothed)
        law = LAW_ERROR * warmer / self.matters if self.referred and not math.isnan(warmer) else 0.0
        self.sum.allowance = ALLOWANCE + law + self.tolerance
        self.sum.update(estimate.stamp, change, seconds)
        self._outlook.take(self.sum.since, estimate.stamp, change)
        self._memory = estimate.memory
        unit = "1" if self.relative else quantity.unit
        shown, uncertain = self._smoothed * self.matters, deviation * self.matters
        self.change = Quantity(f"{self.parameter}_change", unit, shown, uncertain, Validity.VALID)
        # The mean of a first-order process over a long time has the variance of 2 T per s.
        self._variance = 2.0 * estimate.memory * deviation**2
        self.level = None
        if self._exceeds(deviation):
            self.level = Severity.ALARM if abs(self._smoothed) >= ALARMS else Severity.WARNING
        self.released = abs(self._smoothed) < RELEASE
        if self.released and self.sum.size > 0.0:
            # Otherwise a long drift that was repaired would take as long to be forgotten.
            self.sum.up = min(self.sum.up, SHORTEST_SUM)
            self.sum.down = min(self.sum.down, SHORTEST_SUM)

    @property
    def threshold(self) -> float:
        """Sum from which a change is told; NaN while nothing was judged.

        By the spread of estimates that forget over their memory, and so are not independent.
        """
        if math.isnan(self._variance):
            return math.nan
        return max(SHORTEST_SUM, threshold_for(self.run_length, self.sum.allowance, self._variance))

    def _exceeds(self, deviation: float) -> bool:
        """Whether the sum tells of a change."""
        if self.sum.size < SHORTEST_SUM or self.sum.side * self._smoothed <= self.sum.allowance:
            return False
        return self.sum.size >= self.threshold and abs(self._smoothed) > SIGNIFICANCE * deviation

    @property
    def latest_change(self) -> Quantity:
        """The change that the last estimate shows, unsmoothed, with its standard deviation."""
        base = self.baseline.value
        deviation = math.hypot(self.quantity.standard_deviation, self.baseline.spread)
        size, unit = (abs(base), "1") if self.relative else (1.0, self.quantity.unit)
        if not self.quantity.known or not size > 0.0:
            return self.change
        value = (self.quantity.value - base) / size
        return Quantity(self.change.name, unit, value, deviation / size, Validity.VALID)

    @property
    def sure(self) -> str:
        """What speaks for the change being no chance: the false alarms that the test is set to allow."""
        return f"noise alone feigns it once in {duration(self.run_length)} on average"

    @property
    def outlook(self) -> str:
        """When the change reaches the size of an alarm, or that no trend tells it."""
        if self.level is Severity.ALARM:
            return "the limit of an alarm is passed"
        return self._outlook.text(ALARMS, self._memory)

    @property
    def hurries(self) -> bool:
        """Whether it reaches the size of an alarm within a shift, at the present rate."""
        return self._outlook.seconds_to(ALARMS, self._memory) < SHIFT

    def text(self) -> str:
        """Return how the parameter changed, for people: the last estimate against the baseline.

        Not the smoothed change, which lags behind a drift by more than the estimate's interval is wide.
        """
        return change(
            self.quantity.name,
            self.quantity.unit,
            (self.quantity.value, self.quantity.standard_deviation),
            (self.baseline.value, self.baseline.spread),
            relative=self.relative,
        )
