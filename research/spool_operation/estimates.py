"""Estimates that the surrogate makes of a valve-day, as the estimator's node would publish them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_estimator.estimate import Estimate, State
from spool_estimator.identification.oil import LAG, USUAL_DEVIATION
from spool_sim.lubrication import OilTable

from .operating_point import features
from .surrogate import Surrogate, SurrogateRow, errors
from .world import Hold, ValveDay

SECOND = 1_000_000_000
#: s, over which the estimator forgets: the default of its node.
MEMORY = 4.0
#: s of each hold of a healthy day whose estimates are shown: the first ones, then some in every so many. The
#: operating point stays, and the oil warms over minutes.
FIRST, SHOWN, EVERY = 60, 12, 240
#: s behind the newest sample that an estimate describes.
DELAY = 0.005

_NOT_REFERRED = Quantity("referred_viscous_coefficient", "N s/m")
_NOT_MEASURED = Quantity("oil_temperature", "deg C")


class SurrogateEstimates:
    """Surrogate estimates of one valve over its day.

    Attributes:
        truth: viscous coefficient, stiffness and dry friction at each second.

    """

    def __init__(self, day: ValveDay, surrogate: Surrogate) -> None:
        self.day, self.surrogate = day, surrogate
        self.truth = day.viscous(), day.stiffness(), day.friction()
        self._draw = np.random.default_rng([day.seed, 23])
        self._table = OilTable(day.valve)
        self._samples = 0
        self._offsets = self._draw.standard_normal(4)

    def commissioning(self, seconds: int, origin: int) -> Iterator[Estimate]:
        """Yield the estimates from which the baseline is learned, at the temperature of that day."""
        day = self.day
        shaft, celsius = day.commissioned
        viscous = day.valve.viscous_coefficient * float(self._table.ratio(np.array(celsius)))
        truth = np.array([day.valve.spring_stiffness, viscous, day.coulomb])
        offset = float(np.nanmedian(day.reading - day.oil)) if day.thermometer else math.nan
        # The thermometer's constant error is the same on both days, its lag is not.
        reading = np.full(seconds, celsius + offset)
        row = self._row(shaft, viscous, day.coulomb)
        values = np.tile(truth, (seconds, 1))
        yield from self._estimates(
            row, values, reading, np.ones(seconds), origin + SECOND * np.arange(seconds)
        )

    def production(self, hold: Hold, begin: int, end: int, origin: int) -> Iterator[tuple[float, Estimate]]:
        """Yield (s, estimate) from ``begin`` to ``end`` (s) while the machine runs at ``hold``."""
        day, made = self.day, self.surrogate
        count = end - begin
        viscous, stiffness, friction = (truth[begin:end] for truth in self.truth)
        row = self._row(hold.shaft, float(viscous[0]), float(friction[0]))
        values = np.column_stack([stiffness, viscous, friction])
        share = 1.0 - math.exp(-1.0 / MEMORY)
        values, _ = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=(1.0 - share) * values[:1])
        sizes = np.ones(count)
        since = begin - hold.begin
        after_stop = not any(one.end == hold.begin for one in day.holds)
        curve = (made.after_start if after_stop else made.after_change)[since:]
        sizes[: curve.size] = curve[:count]
        stamps = origin + SECOND * day.clock[begin:end]
        settles = max(0, (made.start if after_stop else 0) + math.ceil(hold.ramp) - since)
        run = np.arange(since, since + count)
        shown = (run < FIRST) | (run % EVERY < SHOWN) | (day.fault is not None) | day.dense
        made_of = self._estimates(row, values, day.reading[begin:end], sizes, stamps, shown)
        for number, estimate in zip(np.flatnonzero(shown).tolist(), made_of, strict=True):
            yield float(begin + number), estimate.held() if number < settles else estimate

    def _row(self, shaft: float, viscous: float, coulomb: float) -> SurrogateRow:
        day = self.day
        place = features(day.valve, viscous, coulomb, shaft, day.shaking, day.measuring.noise)
        return self.surrogate.row(place, day.measuring.gain_error, self._offsets, self._draw)

    def _estimates(
        self,
        row: SurrogateRow,
        values: Array,
        reading: Array,
        sizes: Array,
        stamps: NDArray[np.int64],
        shown: NDArray[np.bool_] | None = None,
    ) -> Iterator[Estimate]:
        """Yield estimates of ``values`` (means over the memory), shape (n, 3), where ``shown``."""
        valve, first = self.day.valve, self.day.shaking.first
        shown = np.ones(len(values), bool) if shown is None else shown
        count = len(values)
        force = valve.moving_mass * first
        units = np.column_stack([values[:, 0], values[:, 1], np.full(count, force)])
        estimated = values + units * errors(row, self.surrogate.correlation, sizes, self._draw)
        spread = np.exp(row.spread * self._draw.standard_normal(count))
        reported = units * row.reported * spread[:, np.newaxis]
        residuals = np.abs(row.residual + row.residual_spread * self._draw.standard_normal(count))
        natural = np.sqrt(np.maximum(estimated[:, 0], 1.0) / valve.moving_mass) / (2.0 * math.pi)
        deviations = 0.5 * natural * reported[:, 0] / estimated[:, 0]
        damping = estimated[:, 1] / (4.0 * math.pi * natural * valve.moving_mass)
        referred, uncertain = self._referred(estimated[:, 1], reported[:, 1], reading)
        tracks = self._draw.random(count) < row.tracking if row.tracking < 0.9 else np.ones(count, bool)
        omega = 2.0 * math.pi * valve.natural_frequency
        excitation = Quantity("excitation", "m/s^2", row.excitation * first, validity=Validity.VALID)
        moves = row.displacement * first / omega**2
        displacement = Quantity("relative_displacement", "m", moves, validity=Validity.VALID)
        valid = Validity.VALID
        rows = zip(
            *(
                column[shown].tolist()
                for column in (
                    stamps, estimated, reported, natural, deviations, residuals, referred, uncertain, reading,
                    tracks, damping,
                )
            ),
            strict=True,
        )  # fmt: skip
        for (
            stamp,
            value,
            deviation,
            frequency,
            wide,
            residual,
            at_reference,
            error,
            celsius,
            tracking,
            damped,
        ) in rows:
            self._samples += 1000
            negative = value[2] < 0.0 and value[2] < -3.0 * deviation[2]
            estimate = Estimate(
                stamp,
                "coulomb",
                State.TRACKING,
                0,
                self._samples,
                DELAY,
                MEMORY,
                (
                    Quantity("spring_stiffness", "N/m", value[0], deviation[0], valid),
                    Quantity("viscous_coefficient", "N s/m", value[1], deviation[1], valid),
                    Quantity(
                        "coulomb_force", "N", value[2], deviation[2],
                        Validity.IMPLAUSIBLE if negative else valid,
                    ),
                ),
                Quantity("natural_frequency", "Hz", frequency, wide, valid),
                Quantity("damping_ratio", "1", damped, validity=valid),
                Quantity("residual", "1", residual, validity=valid),
                excitation,
                displacement,
                referred_viscous_coefficient=_NOT_REFERRED
                if math.isnan(at_reference)
                else Quantity("referred_viscous_coefficient", "N s/m", at_reference, error, valid),
                oil_temperature=_NOT_MEASURED
                if math.isnan(celsius)
                else Quantity("oil_temperature", "deg C", celsius, USUAL_DEVIATION, valid),
            )  # fmt: skip
            yield estimate if tracking else estimate.held()

    def _referred(self, viscous: Array, deviation: Array, reading: Array) -> tuple[Array, Array]:
        """Return the coefficient at the reference temperature and its deviation, as ``OilReference`` does."""
        late = round(LAG + DELAY)
        shown = np.concatenate([np.repeat(reading[:1], late), reading])[: reading.size]
        now = self._table.ratio(shown)
        share = 1.0 - math.exp(-1.0 / MEMORY)
        ratio, _ = lfilter([share], [1.0, share - 1.0], now, zi=[(1.0 - share) * now[0]])
        slope = np.log(self._table.ratio(shown - 0.5) / self._table.ratio(shown + 0.5))
        value = viscous / ratio
        return value, np.hypot(deviation / ratio, value * slope * USUAL_DEVIATION)
