"""Plausibility of a valve's description against a record: does the record's spool swing as the file says?

The natural frequency and the damping ratio come from the record alone: the estimator identifies them from
both accelerations, dry friction apart, and gives the same numbers whatever valve file it starts from (the
moving mass only scales forces). A record in which the spool sticks, or that is not excited near the
resonance, gives no tracked estimate, and then nothing is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from spool_core.block import Block
from spool_core.errors import InputError
from spool_core.uncertainty import Z_95, compared
from spool_sim.valve import FILM, Valve
from spool_sim.viscosity import OILS

from spool_estimator.estimator import make_estimator
from spool_estimator.identification.record import Record

from .estimate import Estimate, State
from .estimator import settings_for

#: Tracked estimates that are looked at: the first minute judges the file, later changes are the monitor's.
MOST = 60
#: Tracked estimates below which nothing is said: the median lies outside of the range that 5 draws span in
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
#: Samples in a period of the natural frequency, at least: fewer than two show another frequency (sampling
#: theorem), and the anti-aliasing filter of a data logger takes the octave above.
LEAST_SAMPLES = 4.0
#: Hz, faster than loggers of accelerometers are.
FASTEST = 1e5


@dataclass(frozen=True, slots=True)
class Interval:
    """Interval of 95 % of what a record shows: ``middle`` between ``low`` and ``high``."""

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
        frequency, ratio = estimate.natural_frequency, estimate.damping_ratio
        known = math.isfinite(frequency.value) and math.isfinite(frequency.standard_deviation)
        if self.complete or estimate.state is not State.TRACKING or not known:
            return
        self._frequencies.append(frequency.value)
        self._deviations.append(frequency.standard_deviation)
        if math.isfinite(ratio.value) and math.isfinite(ratio.standard_deviation):
            self._ratios.append(ratio.value + Z_95 * ratio.standard_deviation)

    @property
    def natural_frequency(self) -> Interval | None:
        """Natural frequency that the record shows, Hz; ``None`` where it does not tell.

        From the 2.5 % to the 97.5 % quantile of the estimates, widened by 1.96 times their median standard
        deviation: what a law of friction that the estimator does not know does to it is within.
        """
        if len(self._frequencies) < LEAST:
            return None
        low, middle, high = np.quantile(self._frequencies, (0.025, 0.5, 0.975)).tolist()
        wide = Z_95 * float(np.median(self._deviations))
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
        shown, least = float(np.quantile(self._ratios, 0.975)), self._least_damping()
        if shown >= least:
            return ""
        return (
            f"the valve file of '{self.valve.id}' says a damping ratio of {self.valve.damping_ratio:.2g}, "
            f"and {least:.2g} at least with oil at {HOTTEST:g} deg C in a worn sleeve; the record shows "
            f"{shown:.2g} at most: check dynamic_viscosity (Pa s), radial_clearance and the land (m)"
        )

    def _least_damping(self) -> float:
        """Damping ratio with the oil as hot and the sleeve as worn as can be."""
        oil = OILS[self.valve.oil or COMMON_OIL]
        try:
            here = oil.kinematic_viscosity(self.valve.oil_temperature)
            thinner = oil.kinematic_viscosity(max(HOTTEST, self.valve.oil_temperature)) / here
        except InputError:  # the file's temperature is out of the law's range
            return 0.0
        return self.valve.damping_ratio * thinner / WORN


def check_rate(name: str, sample_rate: float, valve: Valve) -> None:
    """Refuse a record that is sampled too slowly to show the valve's natural frequency.

    Raises:
        InputError: it is; where times in milliseconds or microseconds explain that, they are named.
    """
    needed = LEAST_SAMPLES * valve.natural_frequency
    if sample_rate >= needed:
        return
    units = (("milliseconds", 1e3), ("microseconds", 1e6))
    guess = next((unit for unit, factor in units if sample_rate * factor <= FASTEST), "")
    asked = f"; are its times {guess} instead of seconds?" if guess and sample_rate * 1e3 >= needed else ""
    raise InputError(
        f"{name}: {sample_rate:g} Hz is too slow for the natural frequency of '{valve.id}', "
        f"{valve.natural_frequency:.3g} Hz: sample at {needed:.0f} Hz or more{asked}"
    )


def check_records(valve: Valve, records: Sequence[Record]) -> list[str]:
    """Return a sentence for each contradiction of ``valve`` and ``records`` of it; empty where none is."""
    check = ValveCheck(valve)
    for record in records:
        estimator = make_estimator("prediction", settings_for(valve))
        for block in _blocks(record):
            for estimate in estimator.update(block):
                check.update(estimate)
            if check.complete:
                return check.doubts()
    return check.doubts()


def _blocks(record: Record) -> Iterable[Block]:
    """Yield ``record`` in blocks of a quarter of a second, as an estimator takes them."""
    size = max(1, round(0.25 / record.sample_period))
    for sequence, first in enumerate(range(0, record.body.size, size)):
        yield Block(
            record.start + round(first * record.sample_period * 1e9),
            sequence,
            record.sample_period,
            record.body[first : first + size].astype(np.float32),
            record.spool[first : first + size].astype(np.float32),
        )
