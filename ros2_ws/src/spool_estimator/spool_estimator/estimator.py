"""Estimators of a running valve by name, and the settings of each.

Cheaper than running the model in parallel with the machine, and worse where friction is dry: the direction
of sliding comes from an integrated velocity, which is wrong for a sample or two at each reversal.
"""

from __future__ import annotations

import copy
import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from spool_core.block import Samples
from spool_core.errors import InputError
from spool_core.kernels.samples import StandingWatch
from spool_core.numbers import Array
from spool_core.uncertainty import Quantity, Validity
from spool_sim.valve import Valve

from spool_estimator.identification.oil import oil_law
from spool_estimator.prediction import DELAY
from spool_estimator.recursive import ExponentialForgetting, RecursiveLeastSquares, SlidingLeastSquares
from spool_estimator.sliding_window import (
    BODY,
    COLUMNS,
    DIRECTION,
    DISPLACEMENT,
    SPOOL,
    VELOCITY,
    Conditioning,
)
from spool_estimator.stream_estimator import CHUNK, NAMES, WINDOW, EstimatorSettings, Learned, StreamEstimator
from spool_estimator.tracking import Knowledge, Tracker

#: Relative standard deviation of the stiffness at which learning ends.
LEARNED = 0.02

#: How many phases the estimates of several valves are spread over.
PHASES = 10

#: Standard deviation of the start values in units of their scale, and of the error (N) they are weighed with.
_START, _ERROR = 1.0, 0.05


@dataclass(slots=True)
class Estimator(StreamEstimator):
    """Prediction-error estimator of one valve.

    The model is m a = -c v - k z - F_c sgn(v) (paper eq. (29) with Coulomb friction), ``a`` the spool's
    acceleration, ``z`` and ``v`` its displacement and velocity in the body; it is run in parallel with
    the machine.
    """

    tracker: Tracker | None = field(default=None, init=False)

    @property
    def regression(self) -> RecursiveLeastSquares | SlidingLeastSquares | None:
        """The least squares behind the parameters; ``None`` before the first block."""
        return self.tracker.regression if self.tracker else None

    @property
    def _missing(self) -> tuple[int, int]:
        return (self.tracker.chunk, self.tracker.chunk - self.tracker.filled) if self.tracker else (0, 0)

    @property
    def _began(self) -> Tracker:
        assert self.tracker is not None
        return self.tracker

    @property
    def _standing(self) -> StandingWatch:
        return self._began.standing

    def _restart(self, period: float) -> None:
        settings = self.settings
        if self.tracker is None:
            self.tracker = Tracker(
                period,
                settings.moving_mass,
                settings.scale,
                settings.memory,
                settings.forgetting == WINDOW,
                settings.low_cut,
                settings.high_cut,
                settings.sliding_velocity,
                settings.minimum_excitation,
            )
        elif self.tracker.sample_period != period:
            self.tracker.set_period(period)
        self.tracker.begin()

    def _take(self, body: Samples, spool: Samples, most: int) -> tuple[int, int]:
        return self._began.take(body, spool, most)

    def _close_chunks(self) -> int:
        return self._began.used

    def _learned(self) -> Learned:
        tracker = self._began
        values, covariance = tracker.regression.parameters, tracker.covariance
        return Learned(
            values,
            covariance,
            bool(tracker.started and np.sqrt(covariance[0, 0]) < LEARNED * values[0]),
            tracker.excited,
            tracker.settling,
            np.array([*tracker.powers[:3], tracker.displacement.mean_square]),
            DELAY * tracker.sample_period,
            tracker.refits,
        )

    def _parameter(self, name: str, unit: str, value: float, deviation: float, learned: Learned) -> Quantity:
        """Return the parameter, implausible where clearly negative."""
        negative = value < -3.0 * deviation and value < 0.0
        return Quantity(name, unit, value, deviation, Validity.IMPLAUSIBLE if negative else learned.validity)

    def _knowledge(self) -> Knowledge:
        return self._began.knowledge()

    def _restore(self, known: Knowledge | None) -> None:
        if self.tracker is not None and self.latest is not None:
            self.tracker.restore(known)


@dataclass(slots=True)
class EquationEstimator(StreamEstimator):
    """Equation-error estimator of k, c and F_c from m a = -k z - c v - F_c sgn(v).

    Every signal is conditioned alike (:mod:`.sliding_window`); a chunk without excitation is left out.
    """

    regression: ExponentialForgetting | None = field(default=None, init=False)
    _conditioning: Conditioning | None = field(default=None, init=False)
    _chunk: Samples = field(default_factory=lambda: np.empty((2, 0), np.float32), init=False)
    _rows: Array = field(default_factory=lambda: np.empty((0, COLUMNS)), init=False)
    _filled: int = field(default=0, init=False)
    _since_restart: int = field(default=0, init=False)
    _excited: bool = field(default=False, init=False)
    _settling: bool = field(default=True, init=False)
    _powers: Array = field(default_factory=lambda: np.full(4, math.nan), init=False)
    _watched: StandingWatch = field(default_factory=lambda: StandingWatch(1.0), init=False)

    @property
    def _missing(self) -> tuple[int, int]:
        size = self._chunk.shape[1]
        return size, size - self._filled

    @property
    def _standing(self) -> StandingWatch:
        return self._watched

    def _restart(self, period: float) -> None:
        settings = self.settings
        if self._conditioning is None or self._conditioning.sample_period != period:
            self._conditioning = Conditioning(
                period, settings.low_cut, settings.high_cut, settings.sliding_velocity
            )
            chunk = max(8, round(CHUNK / period))
            self._chunk = np.empty((2, chunk), np.float32)
            self._rows = np.empty((chunk, COLUMNS))
            former = self.regression
            self.regression = self._new_regression()
            if former is not None:
                self.regression.parameters[:] = former.parameters
                self.regression.covariance[:] = former.covariance
                self.regression.errors[:] = former.errors
        self._watched = StandingWatch(period)
        self._conditioning.reset()
        self._powers[2:] = math.nan
        self._filled = self._since_restart = 0

    def _take(self, body: Samples, spool: Samples, most: int) -> tuple[int, int]:  # noqa: ARG002 - one chunk at a time
        size = self._chunk.shape[1]
        count = min(body.size, size - self._filled)
        place = slice(self._filled, self._filled + count)
        self._chunk[0, place] = body[:count]
        self._chunk[1, place] = spool[:count]
        self._filled += count
        if self._filled < size:
            return count, 0
        self._filled = 0
        self._watched.take(self._chunk)
        return count, 1

    def _close_chunks(self) -> int:
        conditioning, regression, rows = self._conditioning, self.regression, self._rows
        assert conditioning is not None
        assert regression is not None
        if self._stands:
            conditioning.reset()
            self._powers[2:] = math.nan
            self._since_restart, self._settling, self._excited = 0, True, False
            return 0
        conditioning.take(self._chunk[0], self._chunk[1], rows)
        self._settling = self._since_restart < conditioning.settling
        self._since_restart += len(rows)
        if self._settling:
            self._excited = False
            return 0
        target = -self.settings.moving_mass * rows[:, SPOOL]
        means = np.mean(np.square(rows), axis=0)
        self._excited = bool(
            math.sqrt(means[VELOCITY]) > 2.0 * self.settings.sliding_velocity
            and means[BODY] > self.settings.minimum_excitation**2
        )
        scaled = rows[:, : DIRECTION + 1] * self.settings.scale
        residual = target - scaled @ regression.parameters
        if self._excited:
            regression.update(scaled, target)
        new = np.array([np.mean(residual**2), np.mean(target**2), means[BODY], means[DISPLACEMENT]])
        share = min(1.0, CHUNK / self.settings.period)
        self._powers = np.where(np.isnan(self._powers), new, (1.0 - share) * self._powers + share * new)
        return len(rows) if self._excited else 0

    def _learned(self) -> Learned:
        conditioning, regression = self._conditioning, self.regression
        assert conditioning is not None
        assert regression is not None
        values = regression.parameters * self.settings.scale
        deviations = regression.standard_deviations * self.settings.scale
        return Learned(
            values,
            np.diag(deviations**2),  # the parameters count as independent
            bool(values[0] > 0.0 and deviations[0] < LEARNED * values[0] and self._samples),
            self._excited,
            self._settling,
            self._powers,
            conditioning.delay * conditioning.sample_period,
        )

    def _parameter(self, name: str, unit: str, value: float, deviation: float, learned: Learned) -> Quantity:
        return Quantity(name, unit, value, deviation, learned.validity)

    def _knowledge(self) -> tuple[ExponentialForgetting | None, Array]:
        return copy.deepcopy(self.regression), self._powers.copy()

    def _restore(self, known: tuple[ExponentialForgetting | None, Array] | None) -> None:
        if known is None:
            self.regression = self._new_regression()
            self._powers, self._samples = np.full(4, math.nan), 0
        else:
            self.regression, self._powers = copy.deepcopy(known[0]), known[1].copy()

    def _new_regression(self) -> ExponentialForgetting:
        assert self._conditioning is not None
        factor = math.exp(-self._conditioning.sample_period / self.settings.memory)
        certain = (_START / _ERROR) ** 2
        return ExponentialForgetting(len(NAMES), factor, certain, largest=3.0 * certain)


#: By name: the model run in parallel with the machine; equation error with exponential forgetting.
ESTIMATORS: dict[str, Callable[[EstimatorSettings], StreamEstimator]] = {
    "prediction": Estimator,
    "equation": EquationEstimator,
}


def phase_of(name: str) -> int:
    """Return a phase that spreads the estimates of many valves; the same name always has the same.

    ``name`` is the valve's namespace, with or without the slash in front.
    """
    return zlib.crc32(name.strip("/").encode()) % PHASES


def settings_for(valve: Valve, **changes: Any) -> EstimatorSettings:
    """Return the settings that a valve's description gives, with ``changes`` by name."""
    return EstimatorSettings(
        moving_mass=valve.moving_mass,
        oil=oil_law(valve),
        **{
            "spring_stiffness": valve.spring_stiffness,
            "viscous_coefficient": valve.likely_viscous_coefficient,
            **changes,
        },
    )


def make_estimator(name: str, settings: EstimatorSettings) -> StreamEstimator:
    """Return a fresh estimator by its name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in ESTIMATORS:
        raise InputError(f"estimator {name}: unknown method; known: {', '.join(ESTIMATORS)}")
    return ESTIMATORS[name](settings)
