"""Displacement of the spool in the body: both accelerations' difference, high-passed and integrated twice.

High-pass and leaky integrators forget their initial state within seconds. Started at zero on a machine that
already runs, they show several times the motion until then. Their initial state is therefore estimated from
the first samples, as the one that leaves the least displacement: any other one adds a slow decay, which
vibration above the low cut does not resemble. Until then the displacement is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

#: Periods of the low cut from which the initial state is estimated: after four of them the rms of a sine at
#: or above the low cut is within 3 % of the settled one, for any phase.
PERIODS = 4.0
#: States of the filter: means of two high-passes, velocity, displacement.
_ORDER = 4
# Places of the numbers: sample period (s), weights of one step, samples of the start and weight of a chunk
# after it, samples taken, samples in the second half of the start, mean square (m^2).
_PERIOD, _PASS, _LEAK, _START, _SHARE, _TAKEN, _LATE, _MEAN_SQUARE = range(8)


class DisplacementArrays(NamedTuple):
    """Arrays of a :class:`Displacement`, which kernels move on in place.

    ``state``: of the filter, started at zero until the initial state is known, shape (4,).
    ``decays``: states of the filter without input, started at each unit state, shape (4, 4).
    ``gram``, ``product``, ``power``: sums over the start and over its second half of decays times decays,
    decays times displacement, and displacement squared, shapes (2, 4, 4), (2, 4), (2,).
    """

    numbers: Array
    state: Array
    decays: Array
    gram: Array
    product: Array
    power: Array


@dataclass(slots=True)
class Displacement:
    """Displacement of the spool in the body: its mean square over about the last second.

    Args:
        sample_period: s.
        low_cut: Hz, -3 dB point of the high-pass.
        chunk: samples taken at a time.
        share: weight of a chunk in the mean square.

    """

    sample_period: float
    low_cut: float
    chunk: int
    share: float
    arrays: DisplacementArrays = field(init=False)

    def __post_init__(self) -> None:
        period, n = self.sample_period, _ORDER
        # Two equal first-order stages are down by 3 dB together at 1.554 times the corner of one.
        pass_on = 1.0 - math.exp(-2.0 * math.pi * self.low_cut / 1.554 * period)
        leak = math.exp(-0.25 * math.pi * self.low_cut * period)
        start = max(2, math.ceil(PERIODS / (self.low_cut * period * self.chunk) - 1e-9)) * self.chunk
        self.arrays = DisplacementArrays(
            np.array([period, pass_on, leak, start, self.share, 0.0, 0.0, math.nan]),
            np.zeros(n), np.eye(n), np.zeros((2, n, n)), np.zeros((2, n)), np.zeros(2),
        )  # fmt: skip

    @property
    def mean_square(self) -> float:
        """Mean square, m^2; NaN until the initial state is known."""
        return float(self.arrays.numbers[_MEAN_SQUARE])

    def reset(self) -> None:
        """Forget every sample."""
        numbers, state, decays, gram, product, power = self.arrays
        numbers[[_TAKEN, _LATE]], numbers[_MEAN_SQUARE] = 0.0, math.nan
        decays[:] = np.eye(_ORDER)
        for sums in (state, gram, product, power):
            sums[:] = 0.0

    def take(self, samples: Samples) -> None:
        """Take a chunk of body and spool, shape (2, chunk), m/s^2."""
        follow_displacement(samples, self.arrays)


@compiled
def follow_displacement(samples: Samples, displacement: DisplacementArrays) -> None:
    """Take a chunk as :meth:`Displacement.take` does."""
    numbers, state = displacement.numbers, displacement.state
    if numbers[_TAKEN] < numbers[_START]:
        _start(samples, displacement)
        return
    period, pass_on, leak = numbers[_PERIOD], numbers[_PASS], numbers[_LEAK]
    total = 0.0
    for i in range(samples.shape[1]):
        # float() of numba keeps single precision.
        _step(state, np.float64(samples[1, i]) - np.float64(samples[0, i]), period, pass_on, leak)
        total += state[3] * state[3]
    numbers[_MEAN_SQUARE] += numbers[_SHARE] * (total / samples.shape[1] - numbers[_MEAN_SQUARE])


@compiled
def _step(state: Array, difference: float, period: float, pass_on: float, leak: float) -> None:
    """Move the filter on by one sample, m/s^2."""
    first = difference - state[0]
    state[0] += pass_on * first
    second = first - state[1]
    state[1] += pass_on * second
    state[2] = leak * state[2] + period * second
    state[3] = leak * state[3] + period * state[2]


@compiled
def _start(samples: Samples, displacement: DisplacementArrays) -> None:
    """Take a chunk of the start; at its end, set the filter to where the best initial state leads."""
    numbers, state, decays, gram, product, power = displacement
    period, pass_on, leak = numbers[_PERIOD], numbers[_PASS], numbers[_LEAK]
    if numbers[_TAKEN] == 0.0:
        state[0] = np.float64(samples[1, 0]) - np.float64(samples[0, 0])
    late = 2.0 * numbers[_TAKEN] >= numbers[_START]
    for i in range(samples.shape[1]):
        _step(state, np.float64(samples[1, i]) - np.float64(samples[0, i]), period, pass_on, leak)
        for j in range(_ORDER):
            _step(decays[j], 0.0, period, pass_on, leak)
        for part in range(2 if late else 1):
            power[part] += state[3] * state[3]
            for j in range(_ORDER):
                product[part, j] += decays[j, 3] * state[3]
                for k in range(_ORDER):
                    gram[part, j, k] += decays[j, 3] * decays[k, 3]
    numbers[_TAKEN] += samples.shape[1]
    numbers[_LATE] += samples.shape[1] if late else 0
    if numbers[_TAKEN] < numbers[_START]:
        return
    # The decays differ in size by a thousand; scaled alike, their condition number is 75.
    size = np.sqrt(np.diag(gram[0]))
    initial = -np.linalg.solve(gram[0] / np.outer(size, size), product[0] / size) / size
    total = power[1]
    for j in range(_ORDER):
        state += initial[j] * decays[j]
        total += 2.0 * initial[j] * product[1, j]
        for k in range(_ORDER):
            total += initial[j] * initial[k] * gram[1, j, k]
    # Rounding may leave less than nothing of a spool that does not move.
    numbers[_MEAN_SQUARE] = max(0.0, total / numbers[_LATE])
