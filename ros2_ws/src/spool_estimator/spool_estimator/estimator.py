"""Prediction-error estimator: the model run in parallel with the machine, see :mod:`.tracking`."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.samples import StandingWatch
from spool_core.uncertainty import Quantity, Validity
from spool_sim.valve.description import Valve

from spool_estimator.identification.oil import oil_law
from spool_estimator.motion.prediction import DELAY
from spool_estimator.recursion.recursive import RecursiveLeastSquares
from spool_estimator.recursion.sliding import SlidingLeastSquares

from .stream_estimator import WINDOW, EstimatorSettings, Learned, StreamEstimator
from .tracking import Knowledge, Tracker

#: Relative standard deviation of the stiffness at which learning ends.
LEARNED = 0.02

#: How many phases the estimates of several valves are spread over.
PHASES = 10


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
