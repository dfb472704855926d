"""Plausibility of a valve's description against a record: does the record's spool swing as the file says?

The natural frequency and the damping ratio come from the record alone: both accelerations give them, dry
friction apart, whatever the valve file says (the moving mass only scales forces). Online they are those of
the estimator, of a whole record those of each second by linear regression. Where the spool sticks, or is not
excited near the resonance, there is no verdict.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Sequence
from dataclasses import dataclass, field

from spool_core.errors import InputError
from spool_core.uncertainty import Z_95, compared
from spool_sim.valve import FILM, OILS, Valve

from spool_estimator.estimate import Estimate, State
from spool_estimator.identification.channel_faults import FITS, PIECE, pair_of
from spool_estimator.identification.channel_pair import Swing
from spool_estimator.identification.record import Record

#: Tracked estimates that are looked at: the first minute judges the file, later changes are the monitor's.
MOST = 60
#: Tracked estimates below which nothing is judged: the median lies outside of the range that 5 draws span in
#: 2 * 0.5^5 = 6 % of cases.
LEAST = 5
#: Relative tolerance of a file's natural frequency: half of 10 % for the rate of a coil spring (a common
#: catalogue tolerance; EN 15800 sets it by grade and coils), half of 10 % for oil and springs in the mass.
TOLERANCE = 0.10
#: deg C: oil that is hotter than this damages seals (ISO 4413 wants less than 80 in the tank), and how far a
#: worn sleeve may have opened its clearance. Less damping than that leaves is not the file's valve.
HOTTEST, WORN = 100.0, 3.0
#: Law by which the viscosity falls where a file names none: the steeper of those that are shipped.
COMMON_OIL = "HL68"


@dataclass(frozen=True, slots=True)
class Interval:
    """Range that a record shows with 95 % confidence: ``middle`` between ``low`` and ``high``."""

    low: float
    middle: float
    high: float

    def texts(self) -> tuple[str, str]:
        """Return both ends with the digits that two of the half width leave."""
        deviation = 0.5 * (self.high - self.low) / Z_95
        low, high = compared((self.low, deviation), (self.high, deviation))
        return low.value, high.value


@dataclass(slots=True)
class ValveCheck:
    """Compares a valve's description with the estimates of a record of it; bounded memory.

    Attributes:
        valve: as it is described.
    """

    valve: Valve
    _frequencies: list[float] = field(default_factory=list, init=False)
    _deviations: list[float] = field(default_factory=list, init=False)
    _ratios: list[float] = field(default_factory=list, init=False)

    @property
    def complete(self) -> bool:
        """Whether further estimates change nothing."""
        return len(self._frequencies) >= MOST

    def update(self, estimate: Estimate) -> None:
        """Take one estimate; what is not tracked tells nothing."""
        if estimate.state is State.TRACKING:
            frequency, ratio = estimate.natural_frequency, estimate.damping_ratio
            self.take(Swing(
                frequency.value, frequency.standard_deviation, ratio.value, ratio.standard_deviation
            ))  # fmt: skip

    def take(self, swing: Swing) -> None:
        """Take how the spool swung for a moment; numbers that are not finite tell nothing."""
        if self.complete or not math.isfinite(swing.frequency + swing.frequency_deviation):
            return
        insort(self._frequencies, swing.frequency)
        insort(self._deviations, swing.frequency_deviation)
        if math.isfinite(swing.ratio + swing.ratio_deviation):
            insort(self._ratios, swing.ratio + Z_95 * swing.ratio_deviation)

    @property
    def natural_frequency(self) -> Interval | None:
        """Natural frequency that the record shows, Hz; ``None`` where it does not tell.

        From the 2.5 % to the 97.5 % quantile of the estimates, widened by 1.96 times their median standard
        deviation: what a law of friction that the estimator does not know does to it is within.
        """
        if len(self._frequencies) < LEAST:
            return None
        low, middle, high = (_quantile(self._frequencies, share) for share in (0.025, 0.5, 0.975))
        wide = Z_95 * _quantile(self._deviations, 0.5)
        return Interval(low - wide, middle, high + wide)

    def doubts(self) -> list[str]:
        """Return a sentence for each way in which file and record contradict; empty where they can agree."""
        return [sentence for sentence in (self._of_frequency(), self._of_damping()) if sentence]

    def _of_frequency(self) -> str:
        shown, filed = self.natural_frequency, self.valve.natural_frequency
        if shown is None:
            return ""
        if shown.low <= filed * (1.0 + TOLERANCE) and filed * (1.0 - TOLERANCE) <= shown.high:
            return ""
        factor = (shown.middle / filed) ** 2
        low, high = shown.texts()
        return (
            f"the valve file of '{self.valve.id}' says {filed:.3g} Hz, the record shows "
            f"{shown.middle:.3g} Hz (95 %: {low} to {high} Hz): another valve's file, "
            f"or spring_stiffness over moving_mass is really {factor:.2g} times the file's; "
            "forces scale with moving_mass, so check it"
        )

    def _of_damping(self) -> str:
        if len(self._ratios) < LEAST or not self.valve.knows(*FILM, "oil_temperature"):
            return ""
        # Least: with the oil as hot and the sleeve as worn as can be.
        oil = OILS[self.valve.oil or COMMON_OIL]
        try:
            here = oil.kinematic_viscosity(self.valve.oil_temperature)
            thinner = oil.kinematic_viscosity(max(HOTTEST, self.valve.oil_temperature)) / here
        except InputError:  # the file's temperature is out of the law's range
            thinner = 0.0
        shown, least = _quantile(self._ratios, 0.975), self.valve.damping_ratio * thinner / WORN
        if shown >= least:
            return ""
        return (
            f"the valve file of '{self.valve.id}' says a damping ratio of {self.valve.damping_ratio:.2g}, "
            f"and {least:.2g} at least with oil at {HOTTEST:g} deg C in a worn sleeve; the record shows "
            f"{shown:.2g} at most: check dynamic_viscosity (Pa s), radial_clearance and the land (m)"
        )


def _quantile(ordered: Sequence[float], share: float) -> float:
    """Return the quantile of a few values in order; NumPy takes a node fifty times as long for that."""
    place = share * (len(ordered) - 1)
    low = min(int(place), len(ordered) - 2)
    return ordered[low] + (place - low) * (ordered[low + 1] - ordered[low])


def check_records(valve: Valve, records: Sequence[Record]) -> list[str]:
    """Return a sentence for each contradiction of ``valve`` and ``records`` of it; empty where none is."""
    check = ValveCheck(valve)
    for record in records:
        size = round(PIECE / record.sample_period)
        for first in range(0, record.body.size, size):
            if check.complete:
                return check.doubts()
            part = slice(first, first + size)
            pair = pair_of(record.body[part], record.spool[part], record.sample_period)
            for swing in pair.swings(MOST, FITS) if pair is not None else ():
                check.take(swing)
    return check.doubts()
