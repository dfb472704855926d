"""Drift of a parameter: sequential test, forecast, cause of a friction change, and what is kept of it.

Page, Biometrika 41 (1954); run length as in Basseville and Nikiforov, Detection of Abrupt Changes, 1993, 5.2.

A straight line through the change since its beginning tells the time to a limit where the second half of it
rises as the first one does; a step, and what has come to rest, tell none.

An estimate has a mean error at one operating point, which no averaging removes. Two sources remain where the
estimator's model holds (`./spool study operation-fit`): a bias of about the reported standard deviation, and
the gain error between both accelerometers. A gain error moves the parameters by an amount that depends on
damping and on how far the spool moves; it cancels as long as these stay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from statistics import NormalDist

import numpy as np
from spool_core.events.event import Facts
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State

from spool_monitor.event import Severity
from spool_monitor.state_file import Baseline
from spool_monitor.warming import FASTEST, PROMPT, SLOWEST, OilLevel, ThermometerLag

#: Standard deviations that a change must exceed before its size is judged at all.
SIGNIFICANCE = 4.0

#: The parameter that follows the oil's temperature.
VISCOUS = "viscous_coefficient"

#: Of the change that matters: what a single value counts for at most, and above what uncertainty nothing is
#: judged.
CAP, UNCERTAIN = 2.5, 0.35
#: Standard deviations from the baseline from which any value is judged.
SURELY = 8.0

#: Shares of the limit below which a change is over (chosen: hysteresis), and from which it is one that rises.
RELEASE, RISES = 0.6, 0.4

#: s for which a machine stays at one operating point. The mean error of an estimate is drawn once for each,
#: so this many independent draws make up a false-alarm interval (study operation: holds of 10 to 60 min).
OPERATING_POINT = 600.0

#: Tested parameters of a valve (k, c, F_c); together they raise one false alarm in a false-alarm interval.
TESTS = 3

#: Times the change that matters, from which a reported change is an alarm, and below which it is a warning
#: again.
ALARMS, EASES = 2.0, 1.6

#: s of a shift: what reaches its limit sooner is not to be planned but done.
SHIFT = 8.0 * 3600.0

#: s, what the sum needs at least: what lasts for a moment only is no change.
SHORTEST_SUM = 1.0

#: s, time constant over which the change that is shown is smoothed: chosen, longer is calmer and later.
SMOOTHING = 3.0

#: 1/K, relative error (standard deviation) of an oil's law per degree away from where the start value was
#: learned.
LAW_ERROR = 0.001

#: Share of a thermometer's uncertainty that changes from day to day (the rest is the same as when the start
#: value was learned), and least relative change of the viscosity per K.
REPEATS, VISCOSITY_PER_KELVIN = 0.3, 0.05

#: s for which a thermometer shows the same, bit for bit, from which it may stand still, where the drag
#: changes meanwhile by this share or more: as by 6 K.
STANDS, CHANGES = 30.0, 0.3

#: Points that are kept, to bound the memory; where there are more, every other one goes.
MOST = 128
#: Points, and memories of the estimator, from which a trend can be seen: what forgets shows a step as a rise.
LEAST, MEMORIES = 8, 4.0
#: Standard deviations that a slope must exceed, and its share in each half of the time, both ways.
SIGNIFICANT, STEADY = 3.0, 0.5
#: s, the longest time to a limit that is reported: a trend of minutes does not predict months.
LONGEST = 30.0 * 86400.0

#: Gain error between two accelerometers of one make, standard deviation, relative: calibrated to 1 to 2 %.
GAIN_ERROR = 0.012

#: Bias over the reported standard deviation: 95 % of 300 operating points are within 1.2, the largest is 2.5.
BIAS = 0.8

#: Sensitivities to the gain error, regression over 300 operating points. Terms of the stiffness: 1, ratio**2,
#: motion, ratio motion, ratio**2 motion; of the drag: 1, 1/ratio, motion/ratio, motion; ratio: of damping.
_STIFFNESS = (1.15, 5.81, -0.99, 2.56, -9.78)
_VISCOUS = (0.87, -0.108, 0.033, -1.74)

#: Standard deviation of sensitivities over all operating points, where that is all that is known; of the dry
#: friction, over the rms inertia force of the body.
ALL = {"spring_stiffness": 0.95, "viscous_coefficient": 1.60}
DRY = 0.4

#: Damping ratios and motions that the regression was made over.
_RATIOS, _MOTIONS = (0.02, 1.1), (0.18, 2.5)


@dataclass(slots=True)
class Outlook:
    """Outlook of one parameter: its changes since the sum of the sequential test left zero.

    ``paused`` (ns) is the time since then in which nothing was measured: what rests does not wear.
    """

    paused: int = field(default=0, init=False)
    _since: int = field(default=0, init=False)
    _points: list[tuple[float, float]] = field(default_factory=list, init=False)
    _every: int = field(default=1, init=False)
    _count: int = field(default=0, init=False)

    def reset(self) -> None:
        """Forget what went before."""
        self._points.clear()
        self._every, self._count, self.paused = 1, 0, 0

    def take(self, since: int, stamp: int, change: float) -> None:
        """Take the ``change`` at ``stamp`` (ns) of a drift that began at ``since`` (ns, 0: there is none)."""
        if since != self._since or since == 0:
            self.reset()
            self._since = since
        if since == 0:
            return
        self._count += 1
        if self._count % self._every == 0:
            self._points.append(((stamp - since - self.paused) * 1e-9, change))
        if len(self._points) > MOST:
            self._points = self._points[::2]
            self._every *= 2

    def seconds_to(self, limit: float, memory: float) -> float:
        """Return the time, s, until the change reaches ``limit`` of the same sign; NaN without a trend.

        Args:
            limit: size of the change, > 0, in the unit of the changes taken.
            memory: s, over which the estimates forget.
        """
        if len(self._points) < LEAST:
            return math.nan
        time, change = np.array(self._points).T
        length = float(time[-1] - time[0])
        if length < MEMORIES * memory:
            return math.nan
        slope, deviation = _slope(time, change, memory)
        half = time.size // 2
        first, second = (
            _slope(time[part], change[part], memory)[0] for part in (slice(half), slice(half, None))
        )
        steady = all(STEADY <= part / slope <= 1.0 / STEADY for part in (first, second)) if slope else False
        now = float(np.mean(change[-max(1, time.size // 8) :]))
        if not steady or abs(slope) < SIGNIFICANT * deviation or slope * now <= 0.0:
            return math.nan
        return max(0.0, (limit - abs(now)) / abs(slope))


@dataclass(slots=True)
class ParameterDrift:
    """Drift test of one parameter: each estimate against its baseline.

    Where the estimates carry it, the viscous coefficient is compared as referred to one oil temperature; a
    start value learned so is never compared with one at any other. While nothing measures the temperature,
    what the oil may have done (:class:`~spool_monitor.warming.OilLevel`) is left out of the comparison.
    Not judged is what is held, what is too uncertain, and what ``update`` must distrust.

    The limit follows from ``run_length``, the mean time (s) to a false alarm of any of the valve's tests, and
    from what is uncertain: the estimate and its mean error at another operating point, the start value, the
    oil's law and thermometer.
    ``matters`` is the change that somebody has to act on, relative to the baseline or absolute
    (``relative``); twice that is urgent. It decides the severity, not whether a change is reported.

    Attributes:
        tolerance: what is let pass on top, in units of the change that matters.
        sensitivity: to a gain error, when the start value was learned; NaN where not known.
        change: of the parameter, smoothed, with its standard deviation.
        quantity: the parameter as it was compared last.
        level: ``None`` while the sum is below its threshold.
        released: whether the change is small enough to be over.
        since: when the change most likely began, ns; 0 where there is none.
        judged: whether the last estimate was.
        assumed: whether nothing measures the oil's temperature: only what oil cannot do is judged.
        doubtful: whether warming oil may be the cause of the change, and nobody knows yet.
        incomparable: whether what is not known could explain any fall of it, as the oil's temperature where
            that is missing since a restart, or changes faster than a thermometer may follow.
        frozen: whether the thermometer has shown the same, bit for bit, since before the change began.

    """

    parameter: str
    matters: float
    relative: bool
    baseline: Baseline
    run_length: float = 365.0 * 86400.0
    tolerance: float = field(default=0.0, init=False)
    referred: bool = field(default=False, init=False)
    temperature: float = field(default=math.nan, init=False)
    sensitivity: float = field(default=math.nan, init=False)
    sum: CumulativeSum = field(init=False)
    change: Quantity = field(init=False)
    quantity: Quantity = field(init=False)
    level: Severity | None = field(default=None, init=False)
    released: bool = field(default=False, init=False)
    judged: bool = field(default=False, init=False)
    assumed: bool = field(default=False, init=False)
    incomparable: bool = field(default=False, init=False)
    frozen: bool = field(default=False, init=False)
    doubtful: bool = field(default=False, init=False)
    oil: OilLevel = field(default_factory=OilLevel, init=False)
    lag: ThermometerLag = field(default_factory=ThermometerLag, init=False)
    _smoothed: float = field(default=math.nan, init=False)
    _variance: float = field(default=math.nan, init=False)
    _last: int = field(default=0, init=False)
    _usual: float = field(default=0.0, init=False)
    _memory: float = field(default=math.nan, init=False)
    _ratio: float = field(default=math.nan, init=False)
    _warmer: float = field(default=0.0, init=False)
    _slowly: float = field(default=0.0, init=False)
    _jumped: float = field(default=0.0, init=False)
    _shown: tuple[float, int] = field(default=(math.nan, 0), init=False)
    _quantile: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    _rising: int = field(default=0, init=False)
    _side: int = field(default=0, init=False)
    _outlook: Outlook = field(default_factory=Outlook, init=False)

    def __post_init__(self) -> None:
        self.sum = CumulativeSum(1.0, CAP)
        # Of what is judged in its own unit there is one, a force.
        self.change = Quantity(f"{self.parameter}_change", "1" if self.relative else "N")
        self.quantity = Quantity(self.parameter, "")

    @property
    def since(self) -> int:
        """When the change most likely began, ns; 0 where there is none."""
        summed = self.sum.since
        return min(summed, self._rising) if summed and self._rising else summed

    @property
    def share(self) -> float:
        """The smoothed change in units of the one that matters; 0 while unknown."""
        return 0.0 if math.isnan(self._smoothed) else self._smoothed

    @property
    def eased(self) -> bool:
        """Whether the smoothed change is below the deadband of an alarm."""
        return abs(self._smoothed) < EASES

    def reset(self) -> None:
        """Forget the sum: what went before may not be believed."""
        self.sum.reset()
        self._outlook.reset()
        self._rising = self._side = 0
        self.level = None
        self.released = False
        self._smoothed = math.nan

    def pause(self, nanoseconds: int) -> None:
        """Skip a time in which nothing was measured: it is no part of a drift."""
        self._last += nanoseconds if self._last else 0
        self._outlook.paused += nanoseconds

    def update(self, estimate: Estimate, *, distrust: bool = False) -> None:
        """Take ``estimate``; parameters that are held are not judged."""
        self.judged = self.incomparable = False
        quantity = self._comparable(estimate)
        if distrust:
            self.reset()
            return
        if quantity is None:
            return
        reference = self.baseline.value if self.baseline.frozen else quantity.value
        size = self.matters * (abs(reference) if self.relative else 1.0)
        # What is far off is certain although it is too uncertain for a change of this size.
        off = abs(quantity.value - reference)
        if not quantity.standard_deviation <= max(UNCERTAIN * size, off / SURELY):
            return
        celsius = estimate.oil_temperature.value
        if not self.baseline.frozen:
            self.baseline.learn(estimate.stamp, quantity.value)
            self.temperature = celsius if math.isnan(self.temperature) else self.temperature
            self.sensitivity = gain_sensitivity(self.parameter, estimate)
            self.oil.know(estimate.stamp)
            self.lag.learning = True
            return
        seconds = (estimate.stamp - self._last) * 1e-9 if self._last else 0.0
        self._last = estimate.stamp
        # What lies between estimates counts, as seldom as they come; a pause does not.
        pauses = seconds > 3.0 * max(1.0, self._usual)
        if seconds > 0.0:
            self._usual = seconds if self._usual == 0.0 else min(self._usual, seconds)
        if pauses or seconds < 0.0:
            seconds = 0.0
        self._judge(estimate, quantity, size, seconds)

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
        warmer = abs(estimate.oil_temperature.value - self.temperature)
        measured = at_reference.known if self.referred else math.isfinite(warmer)
        self.assumed = self.baseline.frozen and not measured
        self._warmer = 0.0 if self.referred or math.isnan(warmer) else warmer
        if self.referred and at_reference.known:
            if at_reference.validity is not Validity.VALID:
                return None
            self._ratio = quantity.value / at_reference.value
            self.oil.know(estimate.stamp)
            if self._ratio > 0.0:
                self.lag.follow(estimate.stamp, math.log(self._ratio))
            return at_reference
        ratio = self._ratio if self.referred else 1.0
        self.incomparable = math.isnan(ratio)
        if not self.assumed:
            self.incomparable = not VISCOSITY_PER_KELVIN * self._warmer < 1.0
            return None if self.referred else quantity
        if self.incomparable or quantity.value / ratio / self.baseline.value <= 0.0:
            return None
        drag = math.log(quantity.value / ratio / self.baseline.value)
        self.oil.follow(estimate.stamp, drag, reported=self.level is not None)
        ratio *= math.exp(self.oil.level)
        value, deviation = quantity.value / ratio, abs(quantity.standard_deviation / ratio)
        return replace(quantity, value=value, standard_deviation=deviation)

    def _thermometer_stands(self, estimate: Estimate) -> bool:
        """Return whether the temperature has been the same since before a large change of the drag began."""
        celsius, (shown, since) = estimate.oil_temperature.value, self._shown
        if celsius != shown or estimate.stamp < since:
            self._shown = celsius, estimate.stamp
            return False
        long = estimate.stamp - since >= STANDS * 1e9 and since <= (self.since or estimate.stamp)
        return long and abs(self.share) * self.matters >= CHANGES

    def _judge(self, estimate: Estimate, quantity: Quantity, size: float, seconds: float) -> None:
        self.judged = True
        self.quantity = quantity
        change = float(quantity.value - self.baseline.value) / size
        if self.parameter == VISCOUS and self.referred and not self.assumed:
            self._follow_oil(estimate, quantity, seconds)
        # What is not the same for a while, in the unit of what is compared.
        raw, scatter = estimate.parameter(self.parameter), quantity.standard_deviation
        if self.referred and raw.value:
            scatter = abs(raw.standard_deviation * quantity.value / raw.value)
        deviation = math.hypot(scatter, self.baseline.spread) / size
        if math.isnan(self._smoothed):
            self._smoothed = change
        self._smoothed += (1.0 - math.exp(-seconds / SMOOTHING)) * (change - self._smoothed)
        self.sum.allowance = self._chance(estimate, quantity, size) + self.tolerance
        # No fall is ever found whose limit is beyond zero.
        self.incomparable = self.incomparable or (self.relative and self.sum.allowance * self.matters >= 1.0)
        self.sum.update(estimate.stamp, change, seconds)
        # Since when the change has been rising to one side: long before it is certain.
        rises = abs(self._smoothed) > RISES * self.sum.allowance
        side = int(math.copysign(1.0, self._smoothed)) if rises else 0
        if side == 0:
            self._rising = 0
        elif side != self._side or self._rising == 0:
            self._rising = estimate.stamp
        self._side = side
        self._doubt(estimate.stamp)
        self._outlook.take(self._rising, estimate.stamp, change)
        self._memory = estimate.memory
        self.frozen = self._thermometer_stands(estimate)
        unit = "1" if self.relative else quantity.unit
        shown, uncertain = self._smoothed * self.matters, deviation * self.matters
        self.change = Quantity(f"{self.parameter}_change", unit, shown, uncertain, Validity.VALID)
        # The mean of a first-order process over a long time has the variance of 2 T per s.
        self._variance = 2.0 * estimate.memory * deviation**2
        self.level = None
        passed = self.sum.size >= SHORTEST_SUM and self.sum.side * self._smoothed > self.sum.allowance
        certain = passed and abs(self._smoothed) > SIGNIFICANCE * deviation
        if certain and self.sum.size >= self.threshold:
            self.level = Severity.ALARM if abs(self._smoothed) >= ALARMS else Severity.WARNING
        self.released = abs(self._smoothed) < RELEASE * self.sum.allowance
        if self.released and self.sum.size > 0.0:
            # Otherwise a long drift that was repaired would take as long to be forgotten.
            self.sum.up = min(self.sum.up, SHORTEST_SUM)
            self.sum.down = min(self.sum.down, SHORTEST_SUM)

    def _follow_oil(self, estimate: Estimate, quantity: Quantity, seconds: float) -> None:
        """Learn how far the thermometer lags, and follow the drag as fast as oil can warm."""
        drag = quantity.value / self.baseline.value
        if drag <= 0.0:
            return
        drag = math.log(drag)
        self.lag.learn(drag, estimate.memory)
        step = FASTEST * seconds
        self._slowly += min(step, max(-step, drag - self._slowly))
        self._jumped = max(self._jumped, abs(drag - self._slowly)) if self._side else 0.0

    def _doubt(self, stamp: int) -> None:
        """Judge whether oil may be the cause: it warms slowly, and a thermometer follows sooner or later."""
        if self.assumed or not self.referred:
            self.doubtful = self.oil.doubtful and self._side < 0
            return
        slow = self._jumped < 0.5 * self.sum.allowance * self.matters and self._side < 0
        follows = self.lag.most < PROMPT or stamp - self._rising >= SLOWEST * 1e9
        self.doubtful = self.parameter == VISCOUS and slow and not follows

    def _chance(self, estimate: Estimate, quantity: Quantity, size: float) -> float:
        """Return the change, in units of ``size``, that chance exceeds once in a false-alarm interval."""
        systematic = systematic_error(self.parameter, estimate, self.sensitivity, quantity.value)
        # A start value is the mean of no more independent estimates than its time has memories.
        memories = max(1.0, self.baseline.duration / (2.0 * estimate.memory))
        variance = systematic**2 + self.baseline.spread**2 / memories
        unknown = 0.0
        if self.parameter == VISCOUS:
            oil, unknown = self._oil(estimate, quantity)
            variance += (oil * quantity.value) ** 2
        if self._quantile[0] != self.run_length:
            draws = max(1.0, TESTS * self.run_length / OPERATING_POINT)
            self._quantile = self.run_length, -NormalDist().inv_cdf(0.5 / draws)
        return self._quantile[1] * math.sqrt(variance) / size + unknown / self.matters

    def _oil(self, estimate: Estimate, quantity: Quantity) -> tuple[float, float]:
        """Return what the oil may change, relative: standard deviation, and a bound where it is unknown."""
        celsius = estimate.oil_temperature.value
        if self.assumed or not self.referred:
            return 0.0, self.oil.unknown if self.assumed else VISCOSITY_PER_KELVIN * self._warmer
        raw = estimate.parameter(VISCOUS)
        total = quantity.standard_deviation / abs(quantity.value)
        own = raw.standard_deviation / abs(raw.value) if raw.value else 0.0
        thermal = math.sqrt(max(0.0, total**2 - own**2))
        law = LAW_ERROR * abs(celsius - self.temperature)
        known = [part for part in (REPEATS * thermal, law) if math.isfinite(part)]
        return math.hypot(*known), self.lag.unknown

    @property
    def threshold(self) -> float:
        """Sum from which a change is reported; NaN while nothing was judged.

        By the spread of estimates that forget over their memory, and so are not independent.
        """
        if math.isnan(self._variance):
            return math.nan
        return max(SHORTEST_SUM, threshold_for(TESTS * self.run_length, self.sum.allowance, self._variance))

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
    def limit(self) -> float:
        """Value of the parameter that the change passed: of an alarm, otherwise of a warning."""
        base = self.baseline.value
        size = self.matters * (abs(base) if self.relative else 1.0)
        passed = ALARMS if self.level is Severity.ALARM else self.sum.allowance
        return base + math.copysign(passed * size, self.share)

    @property
    def bounds(self) -> tuple[float, float]:
        """Values of the parameter, lowest and highest, beyond which it warns; NaN where nothing is judged."""
        base = self.baseline.value
        if not self.baseline.frozen or math.isnan(self._variance) or self.incomparable:
            return math.nan, math.nan
        width = self.sum.allowance * self.matters * (abs(base) if self.relative else 1.0)
        return base - width, base + width

    @property
    def time_to_alarm(self) -> float:
        """Time, s, until the change reaches the size of an alarm; NaN where it has, or no trend tells it."""
        seconds = self._outlook.seconds_to(ALARMS, self._memory)
        return math.nan if self.level is Severity.ALARM or seconds > LONGEST else seconds

    @property
    def hurries(self) -> bool:
        """Whether it reaches the size of an alarm within a shift, at the present rate."""
        return self._outlook.seconds_to(ALARMS, self._memory) < SHIFT

    def facts(self) -> Facts:
        """Return what an event says of the parameter: the last estimate against the baseline.

        Not the smoothed change, which lags behind a drift by more than the estimate's interval is wide.
        """
        return replace(
            Facts.of(replace(self.quantity, name=self.parameter), self.limit),
            baseline=self.baseline.value,
            change=self.quantity.value - self.baseline.value,
            began=self.since,
            false_alarm_interval=self.run_length,
            time_to_limit=self.time_to_alarm,
        )


def threshold_for(run_length: float, allowance: float, variance: float) -> float:
    """Return the threshold that has the mean time ``run_length`` (s) to a false alarm."""
    if variance <= 0.0:
        return 0.0
    # The exponent x of the mean run length solves expm1(x) - x = wanted. The function is convex, so Newton's
    # method falls to x from either of these upper bounds.
    wanted = 2.0 * allowance**2 * run_length / variance
    exponent = min(math.sqrt(2.0 * wanted), 1.0 + math.log1p(wanted))
    for _ in range(50):
        step = (math.expm1(exponent) - exponent - wanted) / math.expm1(exponent)
        exponent -= step
        if step < 1e-12 * exponent:
            break
    return exponent * variance / (2.0 * allowance)


@dataclass(slots=True)
class CumulativeSum:
    """Two-sided cumulative sum of a change, in s times its unit.

    ``allowance`` is the change that is let pass, ``cap`` the largest that a single value counts for.
    ``since`` (ns) is when the larger sum left zero: the most likely onset (Page 1954).
    """

    allowance: float
    cap: float
    up: float = field(default=0.0, init=False)
    down: float = field(default=0.0, init=False)
    _up_since: int = field(default=0, init=False)
    _down_since: int = field(default=0, init=False)

    def update(self, stamp: int, change: float, seconds: float) -> None:
        """Take the change that held for ``seconds`` until ``stamp`` (ns)."""
        bounded = float(min(self.cap, max(-self.cap, change)))
        begin = stamp - round(seconds * 1e9)
        if self.up == 0.0:
            self._up_since = begin
        if self.down == 0.0:
            self._down_since = begin
        self.up = max(0.0, self.up + seconds * (bounded - self.allowance))
        self.down = max(0.0, self.down + seconds * (-bounded - self.allowance))

    def reset(self) -> None:
        """Begin again."""
        self.up = self.down = 0.0

    @property
    def side(self) -> int:
        """1 where it went up, -1 where it went down, 0 where neither sum is above zero."""
        return int(self.up > self.down) - int(self.down > self.up)

    @property
    def since(self) -> int:
        """When the change most likely began, ns; 0 where there is none."""
        return {1: self._up_since, -1: self._down_since, 0: 0}[self.side]

    @property
    def size(self) -> float:
        """The larger of both sums."""
        return max(self.up, self.down)


def gain_sensitivity(parameter: str, estimate: Estimate) -> float:
    """Return the relative change of ``parameter`` over the gain error; NaN where it is not known."""
    known = estimate.damping_ratio.known and estimate.natural_frequency.known
    if parameter not in ALL or not known or not estimate.excitation.value > 0.0:
        return math.nan
    ratio = min(_RATIOS[1], max(_RATIOS[0], estimate.damping_ratio.value))
    omega = 2.0 * math.pi * estimate.natural_frequency.value
    motion = estimate.relative_displacement.value * omega**2 / estimate.excitation.value
    motion = min(_MOTIONS[1], max(_MOTIONS[0], motion))
    if parameter == "spring_stiffness":
        a, b, c, d, e = _STIFFNESS
        return a + b * ratio**2 + c * motion + d * ratio * motion + e * ratio**2 * motion
    a, b, c, d = _VISCOUS
    return a + b / ratio + c * motion / ratio + d * motion


def gain_effect(parameter: str, estimate: Estimate) -> float:
    """Return what a gain error of 1 makes of ``parameter``: relative, of the dry friction in N."""
    if parameter in ALL:
        sensitivity = gain_sensitivity(parameter, estimate)
        return max(abs(sensitivity), 0.5 * ALL[parameter]) if math.isfinite(sensitivity) else ALL[parameter]
    return DRY * inertia_force(estimate) if math.isfinite(inertia_force(estimate)) else 0.0


def inertia_force(estimate: Estimate) -> float:
    """Return the inertia force of the excitation, N rms, NaN where it is not known."""
    stiffness, natural = estimate.parameter("spring_stiffness"), estimate.natural_frequency.value
    mass = stiffness.value / (2.0 * math.pi * natural) ** 2 if natural > 0.0 else math.nan
    return mass * estimate.excitation.value


def systematic_error(parameter: str, estimate: Estimate, healthy: float, value: float) -> float:
    """Return the standard deviation of the mean error of a change since the start value was learned.

    Args:
        parameter: its name.
        estimate: the one that is compared.
        healthy: sensitivity to the gain error when the start value was learned; NaN where not known.
        value: of the parameter as it is compared; the result has its unit.
    """
    raw = estimate.parameter(parameter)
    bias = BIAS * raw.standard_deviation * (abs(value / raw.value) if raw.value else 1.0)
    if parameter in ALL:
        moved, sensitivity = gain_sensitivity(parameter, estimate) - healthy, ALL[parameter]
        if not math.isnan(moved):
            # Around the regression; damping shows the drag.
            ratio = min(_RATIOS[1], max(_RATIOS[0], estimate.damping_ratio.value))
            stiff = parameter == "spring_stiffness"
            around = 0.5 + 1.6 * ratio + 3.5 * ratio**2 if stiff else 0.25 + 0.08 / ratio
            sensitivity = math.hypot(moved, around)
        return math.hypot(bias, GAIN_ERROR * sensitivity * value)
    force = inertia_force(estimate)
    return math.hypot(bias, GAIN_ERROR * DRY * force) if math.isfinite(force) else bias


def _slope(time: Array, change: Array, memory: float) -> tuple[float, float]:
    """Return the slope of ``change`` over ``time`` (s) and its standard deviation.

    Neighbours that share the estimator's memory count as one.
    """
    around = time - time.mean()
    spread = float(around @ around)
    if time.size < 3 or spread <= 0.0:
        return 0.0, math.inf
    slope = float(around @ change) / spread
    left = change - change.mean() - slope * around
    worth = max(3.0, min(float(time.size), (float(time[-1] - time[0])) / max(2.0 * memory, 1e-9)))
    variance = float(left @ left) / time.size * worth / (worth - 2.0)
    return slope, math.sqrt(variance / (spread * worth / time.size))
