"""The viscous coefficient referred to one oil temperature, so that a warm valve does not look worn."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from spool_core.errors import InputError
from spool_core.uncertainty import Quantity, Validity

if TYPE_CHECKING:
    from spool_sim.valve import Valve

#: deg C, standard deviation of a temperature whose message gives none: a class B Pt100 near the valve.
USUAL_DEVIATION = 0.5

#: s, a temperature older than this is no longer known; a valve's oil warms within minutes.
LONGEST_AGE = 60.0

#: s, how long after its measurement a temperature is used: it may travel more slowly than the blocks.
LAG = 0.5
_LAG = round(LAG * 1e9)

#: deg C between which the oil of a machine is: a thermometer that is cut off reads -242 or 850, one without a
#: value often -9999.
COLDEST, HOTTEST = -60.0, 200.0

#: s, a stamp that goes back by more is a new start of time, by less a message that came late.
LATE = 5.0

#: deg C by which the oil has changed over a gap in the motion, and memories in which a regression forgets.
JUMP, FORGETS = 1.0, 4.0


#: K, temperature of 0 deg C.
KELVIN = 273.15


def temperature_fault(stamp: int, celsius: float, now: int = 0) -> str:
    """Return the cause for which a reading of the oil's temperature is not used, empty where it is.

    ``temperature_unit``: it is in kelvin; ``temperature_range``: no oil has it; ``temperature_stamp``: it has
    no stamp, or one further from ``now`` (ns, newest data; 0: unknown) than a temperature is used.
    """
    if not COLDEST <= celsius <= HOTTEST:
        kelvin = COLDEST <= celsius - KELVIN <= HOTTEST
        return "temperature_unit" if kelvin else "temperature_range"
    if stamp <= 0 or (now > 0 and abs(now - stamp) > LONGEST_AGE * 1e9):
        return "temperature_stamp"
    return ""


@dataclass(frozen=True, slots=True)
class OilLaw:
    """How the valve's drag follows its oil's temperature (ASTM D341), as a ratio to the reference point.

    The ratio of dynamic viscosities is that of the drags, pi d l mu / h (paper eq. (7)).
    """

    valve: Valve

    @property
    def reference(self) -> float:
        """Temperature, deg C, that coefficients are referred to: the valve file's."""
        return self.valve.oil_temperature

    def ratio(self, temperature: float) -> float:
        """Return viscosity at ``temperature`` (deg C) over that at the reference, NaN outside of the law."""
        try:
            return self.valve.dynamic_viscosity_at(temperature) / self.valve.dynamic_viscosity
        except InputError:
            return math.nan


def oil_law(valve: Valve) -> OilLaw | None:
    """Return the law of the valve's oil, ``None`` where the description names none that holds."""
    if not valve.oil_ratio_known:
        return None
    law = OilLaw(valve)
    return law if math.isfinite(law.ratio(law.reference)) else None


@dataclass(slots=True)
class OilReference:
    """Follow the oil temperature of one valve and refer its viscous coefficient.

    Temperatures are taken by their stamps, ``LAG`` s behind the motion: which of a temperature and a block
    arrives first makes no difference unless it comes later than that. The coefficient is a mean over the
    memory of the regression, so the viscosity is one over the same time.

    Args:
        law: ``None`` where no law is known: then only the temperature is passed on.
        memory: s, time constant of forgetting.

    """

    law: OilLaw | None
    memory: float
    refused: int = field(default=0, init=False)
    _waiting: deque[tuple[int, float, float]] = field(default_factory=lambda: deque(maxlen=256), init=False)
    _present: tuple[int, float, float] | None = field(default=None, init=False)
    _ratio: float = field(default=math.nan, init=False)
    _behind: float = field(default=0.0, init=False)
    _before: float = field(default=math.nan, init=False)
    _doubted: float = field(default=0.0, init=False)
    _known: bool = field(default=False, init=False)

    def take(self, stamp: int, celsius: float, deviation: float = math.nan) -> None:
        """Take a measurement at ``stamp`` (ns), deg C; what no oil has is counted and never used."""
        if temperature_fault(stamp, celsius):
            self.refused += 1
            return
        last = self._waiting[-1] if self._waiting else self._present
        if last is not None and stamp <= last[0]:
            if last[0] - stamp < LATE * 1e9:
                self.refused += 1
                return
            self._waiting.clear()
            self._present = None
        known = math.isfinite(deviation) and deviation > 0.0
        self._waiting.append((stamp, celsius, deviation if known else USUAL_DEVIATION))

    def restart(self) -> None:
        """Take note of a gap in the motion: the oil may have cooled or warmed meanwhile."""
        self._before = self._present[1] if self._present is not None else math.nan

    def follow(self, stamp: int, seconds: float) -> None:
        """Move on to the motion at ``stamp`` (ns), of which ``seconds`` went into the regression since.

        They are infinite where the regression has forgotten what was before. The oil is taken to have been as
        it is now while its temperature was not known.
        """
        stamp -= _LAG
        while self._waiting and self._waiting[0][0] <= stamp:
            self._present = self._waiting.popleft()
        self._behind += seconds
        self._known = self._fresh(stamp)
        if not self._known or self._present is None or self.law is None:
            return
        # After a jump nobody knows of which oil most of the regression is: until it has forgotten the former.
        jumped = abs(self._present[1] - self._before) > JUMP
        self._doubted = (FORGETS * self.memory if jumped else self._doubted) - self._behind
        share = 1.0 if jumped else 1.0 - math.exp(-self._behind / self.memory)
        now = self.law.ratio(self._present[1])
        self._ratio = now if math.isnan(self._ratio) else self._ratio + share * (now - self._ratio)
        self._behind, self._before = 0.0, math.nan

    def temperature(self, stamp: int) -> Quantity:
        """Return the temperature at ``stamp`` (ns), unknown where it is too old or there is none."""
        if self._present is None or not self._fresh(stamp - _LAG):
            return Quantity("oil_temperature", "deg C")
        return Quantity("oil_temperature", "deg C", self._present[1], self._present[2], Validity.VALID)

    def _fresh(self, stamp: int) -> bool:
        return self._present is not None and 0 <= stamp - self._present[0] <= LONGEST_AGE * 1e9

    def referred(self, viscous: Quantity) -> Quantity:
        """Return ``viscous`` (N s/m) as it would be at the reference temperature.

        The uncertainty of the temperature goes in through the slope of the law.
        """
        name = "referred_viscous_coefficient"
        known = self._known and math.isfinite(self._ratio) and not math.isnan(viscous.value)
        if self.law is None or self._present is None or not known:
            return Quantity(name, viscous.unit)
        _, celsius, deviation = self._present
        value = viscous.value / self._ratio
        colder, warmer = self.law.ratio(celsius - 0.5), self.law.ratio(celsius + 0.5)
        slope = math.log(colder / warmer) if colder > 0.0 and warmer > 0.0 else math.nan
        total = math.hypot(viscous.standard_deviation / self._ratio, value * slope * deviation)
        doubtful = self._doubted > 0.0 and viscous.validity is Validity.VALID
        return Quantity(name, viscous.unit, value, total, Validity.HELD if doubtful else viscous.validity)
