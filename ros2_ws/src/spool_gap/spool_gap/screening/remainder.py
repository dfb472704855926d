"""Predictable shares of a residual: does it follow position, speed, time, the past, whatever the law?

Smooth functions of the measured motion, as forces through the linear base, are fitted to the errors of the
training windows and must predict those of the held-out ones. Noise is not predictable, whatever its level,
so a share that is says that the model is not complete, and of what the missing part is a function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from spool_estimator.identification.spectra import DRIVE_ONLY, quiet

from spool_gap.simulation.point import Point
from spool_gap.simulation.response import responses
from spool_gap.simulation.segments import Stretch
from spool_gap.simulation.simulate import Simulation
from spool_gap.thresholds import THRESHOLDS

Array = NDArray[np.float64]

#: Power of the reading over the residual's from which it is motion: below, both hold the same noise, which
#: the one would predict the other by. Errors of a channel are a seventh of its amplitude at most.
LOUD = 50.0
#: Relative eigenvalue of the columns' products below which a combination of columns is not fitted.
ALIKE = 1e-6


@dataclass(frozen=True, slots=True)
class PredictableShares:
    """Predictable shares of what is left.

    Attributes:
        shares: of the weighed held-out squares, by what they are predicted from; 0 or less: not at all.
        numbers: weighed held-out numbers.
    """

    shares: Mapping[str, float]
    numbers: int

    @property
    def follows(self) -> str:
        """What predicts most."""
        return max(self.shares, key=lambda name: self.shares[name])

    @property
    def share(self) -> float:
        """The largest share."""
        return self.shares[self.follows]

    @property
    def evidence(self) -> float:
        """Twice the log likelihood ratio on held-out data of predicting over not predicting."""
        return -self.numbers * float(np.log(max(1e-12, 1.0 - self.share)))

    def counts(self, nrmse: float, before: float, *, kinks: bool = True) -> bool:
        """Whether a model that leaves ``nrmse``, and the base ``before``, is not complete.

        ``kinks`` says whether its forces have any.
        """
        size = float(np.sqrt(max(0.0, self.share))) * nrmse
        share = THRESHOLDS.predictable_of_gap if kinks else THRESHOLDS.predictable_of_gap_smooth
        least = max(THRESHOLDS.predictable_smallest, share * before)
        enough = self.evidence > THRESHOLDS.predictable_evidence
        return self.share > THRESHOLDS.predictable and enough and size > least


@dataclass(frozen=True, slots=True)
class _ScaledMotion:
    position: Array
    speed: Array
    slip: Array
    time: Array
    acceleration: Array


def remainder(
    simulation: Simulation, point: Point, train: Sequence[Array], held: Sequence[Array]
) -> PredictableShares:
    """Return the predictable shares of the errors that ``point`` leaves.

    Args:
        simulation: the windows, with a weight.
        point: gives the linear base.
        train, held: model - measured of the windows, m/s^2, shape (1, n) each.
    """
    training, held_out = simulation.training, simulation.held_out
    target = simulation.weigh(train, training)[0]
    wanted = simulation.weigh(held, held_out)[0]
    # Windows in which the motion went another way say nothing about what is missing.
    fits, judges = simulation.trust(target, training), simulation.trust(wanted, held_out)
    target, wanted = target * fits, wanted * judges
    motions = [_motion(stretch) for stretch in simulation.stretches]

    def predicted(rows: Sequence[Array]) -> float:
        """Return the share of the held-out squares that ``rows``, fitted to the others, predict."""
        fitted = simulation.weigh([rows[place] for place in training], training) * fits
        other = simulation.weigh([rows[place] for place in held_out], held_out) * judges
        size = np.linalg.norm(fitted, axis=1)
        used = size > 1e-9 * max(float(size.max()), 1e-30)
        fitted, other = fitted[used] / size[used, np.newaxis], other[used] / size[used, np.newaxis]
        products, vectors = np.linalg.eigh(fitted @ fitted.T)
        kept = products > ALIKE * products[-1]
        weights = vectors[:, kept] @ ((vectors[:, kept].T @ (fitted @ target)) / products[kept])
        left = wanted - weights @ other
        return 1.0 - float(left @ left) / float(wanted @ wanted)

    shares = {}
    for name, functions in FUNCTIONS.items():
        forces = [functions(motion) for motion in motions]
        slopes = SLOPES.get(name, ())
        shares[name] = min(
            predicted(responses(simulation, point, forces.__getitem__, slopes, readings=readings))
            for readings in ((None, _LoudReadings(simulation)) if slopes else (None,))
        )
    return PredictableShares(shares, wanted.size)


@dataclass(frozen=True, slots=True)
class _LoudReadings:
    """What of the spool's reading of a stretch is much louder than what is left, m/s^2."""

    simulation: Simulation

    def __call__(self, number: int) -> Array:
        record = self.simulation.stretches[number].record

        def density(frequency: Array) -> Array:
            return LOUD / DRIVE_ONLY * self.simulation.residual_density(number, frequency)

        return quiet(record.spool, density, record.sample_rate).apply(record.spool)


def _motion(stretch: Stretch) -> _ScaledMotion:
    z, v = stretch.motion.displacement, stretch.motion.velocity
    travel = float(np.quantile(np.abs(z), 0.999)) or 1e-12
    speed = float(np.quantile(np.abs(v), 0.99)) or 1e-12
    reversals = np.concatenate([[0], np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1])) + 1])
    last = reversals[np.searchsorted(reversals, np.arange(v.size), side="right") - 1]
    return _ScaledMotion(
        np.clip(z / travel, -1.0, 1.0),
        np.asarray(v / speed),
        (z - z[last]) / (float(np.std(z)) or 1e-12),
        np.linspace(-1.0, 1.0, z.size, dtype=np.float64),
        stretch.motion.acceleration / (float(np.std(stretch.motion.acceleration)) or 1e-12),
    )


#: Forces (c, n) along a motion.
Functions = Callable[[_ScaledMotion], Array]


def _position(motion: _ScaledMotion) -> Array:
    return np.asarray(chebyshev.chebvander(motion.position, 9)[:, 1:].T)


def _speed(motion: _ScaledMotion) -> Array:
    v, sign = motion.speed, np.sign(motion.speed)
    falling = [sign * np.exp(-np.abs(v) / width) for width in (0.03, 0.1, 0.3)]
    return np.array([v, sign, sign * v**2, v**3, sign * np.sqrt(np.abs(v)), np.abs(v), v**2, *falling])


def _both(motion: _ScaledMotion) -> Array:
    z, v, sign = motion.position, motion.speed, np.sign(motion.speed)
    return np.array(
        [v * z, v * z**2, v * z**3, v * z**4, sign * z, sign * z**2, sign * z**3, v**2 * z, np.abs(v) * z]
    )


def _past(motion: _ScaledMotion) -> Array:
    sign, slip = np.sign(motion.speed), np.abs(motion.slip)
    return np.array([sign * np.exp(-slip / width) for width in (0.02, 0.06, 0.2, 0.6, 2.0)])


def _time(motion: _ScaledMotion) -> Array:
    t, columns = motion.time, (motion.position, motion.speed, np.sign(motion.speed), motion.acceleration)
    return np.array([*(t * row for row in columns), *(t**2 * row for row in columns)])


def _frequency(motion: _ScaledMotion) -> Array:
    return np.empty((0, motion.time.size))


FUNCTIONS: Mapping[str, Functions] = {
    "position": _position,
    "speed": _speed,
    "position and speed": _both,
    "the way since the last reversal": _past,
    "time": _time,
    "frequency": _frequency,
}
#: Orders of derivatives of the spool's reading.
SLOPES: Mapping[str, tuple[int, ...]] = {"frequency": (1, 2, 3, 4, 5)}
