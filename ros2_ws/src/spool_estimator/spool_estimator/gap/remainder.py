"""What is left of a fitted model, looked at without a law: does it follow position, speed, time, the past?

Smooth functions of the measured motion, as forces through the linear base, are fitted to the errors of the
training windows and must foretell those of the held-out ones. Noise cannot be foretold, whatever its level,
so a share that is says that the model is not complete, and of what the missing part is a function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy import fft

from ..zero_phase import ZeroPhase, interval_mean_response
from .simulate import Point, Simulation
from .stretches import Stretch

Array = NDArray[np.float64]

#: Relative eigenvalue of the columns' products below which a combination of columns is not fitted.
ALIKE = 1e-6


@dataclass(frozen=True, slots=True)
class Remainder:
    """How much of what is left can be foretold.

    Attributes:
        shares: of the weighed held-out squares, by what they are foretold from; 0 or less: not at all.
        numbers: weighed held-out numbers.
    """

    shares: Mapping[str, float]
    numbers: int

    @property
    def follows(self) -> str:
        """What foretells most."""
        return max(self.shares, key=lambda name: self.shares[name])

    @property
    def share(self) -> float:
        """The largest share."""
        return self.shares[self.follows]

    @property
    def evidence(self) -> float:
        """Twice the log likelihood ratio on held-out data of foretelling over not foretelling."""
        return -self.numbers * float(np.log(max(1e-12, 1.0 - self.share)))


@dataclass(frozen=True, slots=True)
class _Motion:
    position: Array
    speed: Array
    slip: Array
    time: Array
    spool: Array
    acceleration: Array


def remainder(simulation: Simulation, point: Point, train: list[Array], held: list[Array]) -> Remainder:
    """Return what foretells the errors that ``point`` leaves.

    Args:
        simulation: the windows, with a weight.
        point: gives the linear base.
        train, held: model - measured of the windows, m/s^2, shape (1, n) each.
    """
    training, held_out = simulation.training, simulation.held_out
    target = simulation.weigh(train, training)[0]
    wanted = simulation.weigh(held, held_out)[0]
    columns = {name: _columns(simulation, point, functions) for name, functions in FUNCTIONS.items()}
    shares = {}
    for name, rows in columns.items():
        fitted = simulation.weigh([rows[place] for place in training], training)
        other = simulation.weigh([rows[place] for place in held_out], held_out)
        size = np.linalg.norm(fitted, axis=1)
        used = size > 1e-9 * max(float(size.max()), 1e-30)
        fitted, other = fitted[used] / size[used, np.newaxis], other[used] / size[used, np.newaxis]
        products, vectors = np.linalg.eigh(fitted @ fitted.T)
        kept = products > ALIKE * products[-1]
        weights = vectors[:, kept] @ ((vectors[:, kept].T @ (fitted @ target)) / products[kept])
        left = wanted - weights @ other
        shares[name] = 1.0 - float(left @ left) / float(wanted @ wanted)
    return Remainder(shares, wanted.size)


def _columns(simulation: Simulation, point: Point, functions: Functions) -> dict[int, Array]:
    """Return what ``functions`` add to the error of each window, shape (c, n) each."""
    found: dict[int, Array] = {}
    for stretch in simulation.stretches:
        places = [n for n, (own, _, _) in enumerate(simulation.places) if own is stretch]
        if not places:
            continue
        rows = _through(stretch, point, functions, means=simulation.jumps is None)
        for place in places:
            window = simulation.places[place][1]
            part = slice(window.start, window.stop)
            mask = stretch.kept[part]
            if simulation.jumps is not None:
                mask = mask * simulation.jumps[place]
            found[place] = rows[:, part] * mask
    return found


def _through(stretch: Stretch, point: Point, functions: Functions, *, means: bool) -> Array:
    """Return the accelerations (c, n) that the forces of ``functions`` give the spool of the linear base."""
    period = stretch.record.sample_period
    motion = _motion(stretch)
    forces, sensed = functions(motion)
    count = forces.shape[1]
    reach = min(count - 1, round(1.0 / (stretch.low_cut * period)))
    length = fft.next_fast_len(count + 2 * reach, real=True)
    frequency = fft.rfftfreq(length, period)
    turn = 2j * np.pi * frequency
    values = point.values
    through = turn**2 / (
        values["mass"] * turn**2 + values["viscous_coefficient"] * turn + values["spring_stiffness"]
    )
    # A derivative of what the sensor reads, in units of the drive's upper end.
    sensor = ZeroPhase(period, stretch.low_cut, min(3.0 * stretch.noise.high, 0.4 / period)).gain(frequency)
    slope = turn / (2.0 * np.pi * stretch.noise.high)
    rows = []
    for row, response in [
        *((force, through) for force in forces),
        *((stretch.quiet.apply(stretch.record.spool), sensor * slope**order) for order in sensed),
    ]:
        padded = np.pad(row, reach, mode="reflect", reflect_type="odd")
        lines = fft.rfft(padded, length) * response
        if means:
            lines *= interval_mean_response(frequency, period)
        rows.append(fft.irfft(lines, length)[reach : reach + count])
    return np.array(rows)


def _motion(stretch: Stretch) -> _Motion:
    z, v = stretch.motion.displacement, stretch.motion.velocity
    travel = float(np.quantile(np.abs(z), 0.999)) or 1e-12
    speed = float(np.quantile(np.abs(v), 0.99)) or 1e-12
    reversals = np.concatenate([[0], np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1])) + 1])
    last = reversals[np.searchsorted(reversals, np.arange(v.size), side="right") - 1]
    return _Motion(
        np.clip(z / travel, -1.0, 1.0),
        v / speed,
        (z - z[last]) / (float(np.std(z)) or 1e-12),
        np.linspace(-1.0, 1.0, z.size),
        stretch.motion.spool / (float(np.std(stretch.motion.spool)) or 1e-12),
        stretch.motion.acceleration / (float(np.std(stretch.motion.acceleration)) or 1e-12),
    )


#: Forces (c, n) as functions of the motion, and orders of derivatives of the spool's reading.
Functions = Callable[[_Motion], tuple[Array, tuple[int, ...]]]


def _position(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    return chebyshev.chebvander(motion.position, 9)[:, 1:].T, ()


def _speed(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    v, sign = motion.speed, np.sign(motion.speed)
    falling = [sign * np.exp(-np.abs(v) / width) for width in (0.03, 0.1, 0.3)]
    return np.array([v, sign, sign * v**2, v**3, sign * np.sqrt(np.abs(v)), np.abs(v), v**2, *falling]), ()


def _both(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    z, v, sign = motion.position, motion.speed, np.sign(motion.speed)
    return np.array(
        [v * z, v * z**2, v * z**3, v * z**4, sign * z, sign * z**2, sign * z**3, v**2 * z, np.abs(v) * z]
    ), ()


def _past(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    sign, slip = np.sign(motion.speed), np.abs(motion.slip)
    return np.array([sign * np.exp(-slip / width) for width in (0.02, 0.06, 0.2, 0.6, 2.0)]), ()


def _time(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    t, columns = motion.time, (motion.position, motion.speed, np.sign(motion.speed), motion.acceleration)
    return np.array([*(t * row for row in columns), *(t**2 * row for row in columns)]), ()


def _frequency(motion: _Motion) -> tuple[Array, tuple[int, ...]]:
    return np.empty((0, motion.time.size)), (1, 2, 3, 4, 5)


FUNCTIONS: Mapping[str, Functions] = {
    "position": _position,
    "speed": _speed,
    "position and speed": _both,
    "the way since the last reversal": _past,
    "time": _time,
    "frequency": _frequency,
}
