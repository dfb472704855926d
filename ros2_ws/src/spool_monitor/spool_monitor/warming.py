"""What warming oil does to the drag where no thermometer, or one that lags, measures it.

A film's drag follows the oil's viscosity. Oil warms no faster than ``FASTEST``; what falls faster is no oil.
What falls more slowly may be: wear and oil differ in what comes back after a cold start, as oil cools to its
surroundings and wear does not heal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from statistics import median

#: 1/s, fastest change of the logarithm of a viscosity: 3 K/min, at 9 % per K (ISO VG oils in the cold, D341).
FASTEST = 3.0 / 60.0 * 0.09
#: s of standstill after which a start is cold (tanks cool with time constants of 2 to 4 h); s compared of it.
COOLED, COLD = 4.0 * 3600.0, 15.0
#: Standstill of a start that is compared, over that of the present one, at most: it was no colder.
SHORTER = 1.25
#: Change of the logarithm by surroundings that are 3 K warmer, at 5 % per K.
SURROUNDINGS = 0.15
#: Cold starts that are kept; cold starts in a row with too little drag after which it is no warm day.
KEPT, SURELY = 9, 3
#: s for which a change that was found may still grow; s after a cold start in which it was found by it.
GROWS, AFTER = 30.0, 40.0
#: s, by which a thermometer may lag at most; share of a lag, and s, to which it is known besides its
#: deviation: a change of the rate is smoothed.
SLOWEST, WITHIN, TO = 600.0, 0.2, 20.0
#: 1/s, rate that is no flicker of a thermometer: 0.1 K/min, at 6 % per K.
SEEN = 1e-4
#: s by which a thermometer follows so soon that what it does not show is no oil.
PROMPT = 120.0
#: s over which a temperature's rate is smoothed, and over which a lag is remembered.
SMOOTHED, REMEMBERED = 60.0, 3600.0


@dataclass(slots=True)
class OilLevel:
    """Logarithm of the drag over its start value that unmeasured oil explains, from estimate to estimate.

    Attributes:
        level: it.
        doubtful: whether the change that is reported was found by a cold start, and a warm day explains it.
    """

    level: float = field(default=0.0, init=False)
    doubtful: bool = field(default=False, init=False)
    _stamp: int | None = field(default=None, init=False)
    _starts: list[tuple[float, float]] = field(default_factory=list, init=False)
    _start: list[float] = field(default_factory=list, init=False)
    _rest: float = field(default=0.0, init=False)
    _since: float = field(default=math.inf, init=False)
    _low: int = field(default=0, init=False)
    _held: float = field(default=math.inf, init=False)
    _beyond: float = field(default=0.0, init=False)

    def know(self, stamp: int) -> None:
        """Set at ``stamp`` (ns): the oil is as it was for the start value, or its temperature is measured."""
        self.level, self._stamp, self._since = 0.0, stamp, math.inf
        self._starts = [(0.0, 0.0)]

    @property
    def unknown(self) -> float:
        """What the surroundings may have changed besides."""
        return SURROUNDINGS if self._since < AFTER else 0.0

    def follow(self, stamp: int, drag: float, *, reported: bool) -> None:
        """Take the logarithm of the ``drag`` over its start value at ``stamp`` (ns)."""
        last, self._stamp = self._stamp, stamp
        if last is None or stamp < last:  # a start value of a former run, or a clock that was set
            self.level, self._since, self._beyond = drag, math.inf, 0.0
            return
        seconds = (stamp - last) * 1e-9
        self._held = 0.0 if not reported else self._held + seconds
        if seconds >= COOLED:
            self._rest, self._since, self._beyond = seconds, 0.0, 0.0
            self._start.clear()
        elif self._since < COLD <= self._since + seconds:
            self._low = self._low + 1 if reported else 0
            if not reported:
                self._starts = [*self._starts[1 - KEPT :], (self._rest, median(self._start))]
        self._since += seconds if seconds < COOLED else 0.0
        settling = reported and (self._held < GROWS or self._since < AFTER)
        if self._since < COLD:
            self._start.append(drag)
            known = [level for rest, level in self._starts if rest <= SHORTER * self._rest]
            self.level = max(drag, median(known)) if known else drag
        elif not settling:
            step = FASTEST * seconds
            self.level += min(step, max(-step, drag - self._beyond - self.level))
        if settling:
            self._beyond = drag - self.level
        if not reported:
            self._beyond, self.doubtful = 0.0, self._since < AFTER
        self.doubtful = self.doubtful and self._low < SURELY


@dataclass(slots=True)
class ThermometerLag:
    """Lag of a thermometer behind the oil, s, by least squares from the drag itself.

    Referred to a temperature that lags by T, the logarithm y of a drag departs by T times the rate at which
    the logarithm of the viscosity follows the thermometer.

    Attributes:
        rate: that rate, 1/s; ``start``: what it was when the start value was learned.
        learning: whether that is being learned; a rate needs longer to be seen.
    """

    rate: float = field(default=0.0, init=False)
    start: float = field(default=0.0, init=False)
    learning: bool = field(default=False, init=False)
    _smoothed: float = field(default=math.nan, init=False)
    _stamp: int = field(default=0, init=False)
    _age: float = field(default=0.0, init=False)
    _seconds: float = field(default=0.0, init=False)
    _sums: list[float] = field(default_factory=lambda: [0.0] * 6, init=False)

    def follow(self, stamp: int, viscosity: float) -> None:
        """Take the logarithm of the viscosity at the thermometer's temperature at ``stamp`` (ns)."""
        self._seconds, self._stamp = (stamp - self._stamp) * 1e-9, stamp
        if math.isnan(self._smoothed) or not 0.0 <= self._seconds <= SMOOTHED:
            self._smoothed, self._age, self._seconds = viscosity, 0.0, 0.0
        self._age += self._seconds
        self._smoothed += (viscosity - self._smoothed) * (1.0 - math.exp(-self._seconds / SMOOTHED))
        # Of a straight line this is the rate from its beginning on.
        self.rate = (viscosity - self._smoothed) / (SMOOTHED * -math.expm1(-max(self._age, 1.0) / SMOOTHED))
        if self.learning:
            self.start, self.learning = self.rate, self._age < 0.5 * SMOOTHED

    def learn(self, drag: float, memory: float) -> None:
        """Take the logarithm of the referred ``drag`` over its start value, of estimates over ``memory`` s.

        Once it is known that the thermometer is prompt, a drag that moves is no lag.
        """
        seconds = self._seconds
        if self._age < 0.5 * SMOOTHED or self.most < PROMPT:
            return
        keep, weight = math.exp(-seconds / REMEMBERED), seconds / (2.0 * memory)
        new = (1.0, self.rate, drag, self.rate**2, self.rate * drag, drag**2)
        self._sums = [keep * old + weight * one for old, one in zip(self._sums, new, strict=True)]

    @property
    def most(self) -> float:
        """The lag, s, that it hardly exceeds: ``SLOWEST`` until the oil has warmed or cooled."""
        count, rates, drags, squares, products, powers = self._sums
        if count < 4.0 or not squares - rates**2 / count > count * SEEN**2:
            return SLOWEST
        spread, common = squares - rates**2 / count, products - rates * drags / count
        power = powers - drags**2 / count
        lag = common / spread
        variance = max(0.0, power - common**2 / spread) / (count - 2.0) / spread
        return min(SLOWEST, (1.0 + WITHIN) * max(0.0, lag) + 3.0 * math.sqrt(variance) + TO)

    @property
    def unknown(self) -> float:
        """What a lag may have changed of the logarithm of the drag, against the start value."""
        return self.most * abs(self.rate - self.start)
