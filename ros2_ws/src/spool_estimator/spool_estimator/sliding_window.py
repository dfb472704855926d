"""Window of least squares, and the conditioning of the signals that go into it.

Every channel passes the same linear-phase band-pass, so a delay common to all is the only trace that
filtering leaves. The high-pass is "delayed signal less its triangular mean" (two running means): it removes
constants and ramps exactly, so that integrals of its output stay bounded without any leak. The low-pass is a
triangular mean as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

Counts = NDArray[np.int64]

#: Columns of a row: relative displacement (m), relative velocity (m/s), direction of sliding (1),
#: spool acceleration (m/s^2), body acceleration (m/s^2).
DISPLACEMENT, VELOCITY, DIRECTION, SPOOL, BODY = range(5)
COLUMNS = 5

_HIGH_PASS_ROWS = 16  # eight high-passes of two running means
_LOW_PASS_ROWS = 8  # four channels of two running means


class WindowArrays(NamedTuple):
    """Arrays of a :class:`ChunkWindow`, which kernels move on in place; ``taken``: chunks, shape (1,)."""

    taken: Counts
    grams: Array
    products: Array
    powers: Array


@dataclass(slots=True)
class ChunkWindow:
    """Sums of ``length`` chunks; ``scale``, shape (p,), makes parameters of order one."""

    scale: Array
    length: int = 10
    _taken: Counts = field(init=False)
    _grams: Array = field(init=False)
    _products: Array = field(init=False)
    _powers: Array = field(init=False)

    def __post_init__(self) -> None:
        size = self.scale.size
        self._taken = np.zeros(1, np.int64)
        self._grams = np.zeros((self.length, size, size))
        self._products = np.zeros((self.length, size))
        self._powers = np.zeros((self.length, 2))

    @property
    def arrays(self) -> WindowArrays:
        """What the kernels move on in place."""
        return WindowArrays(self._taken, self._grams, self._products, self._powers)

    def add_sums(self, gram: Array, score: Array, power: float, samples: float, parameters: Array) -> None:
        """Take a chunk by its sums over scaled rows: row row^T, row error, error^2, at ``parameters``."""
        _add(self.arrays, gram, score, power, samples, parameters / self.scale)

    def clear(self) -> None:
        """Forget all chunks."""
        self._taken[0] = 0

    def best(self, last: int | None = None) -> Array:
        """Return what fits the ``last`` chunks (all) best, shape (p,); the smallest if several do."""
        verdict = np.zeros(3 + self.scale.size)
        _judge(self.arrays, last or self.length, np.zeros(self.scale.size), verdict)
        return np.asarray(verdict[3:] * self.scale)


@compiled
def take_chunk(
    window: WindowArrays,
    gram: Array,
    score: Array,
    power: float,
    samples: float,
    given: Array,
    lasts: Counts,
    verdicts: Array,
) -> None:
    """Take a chunk into a window, and fill ``verdicts`` for each of ``lasts``."""
    _add(window, gram, score, power, samples, given)
    for which in range(lasts.size):
        _judge(window, lasts[which], given, verdicts[which])


@dataclass(slots=True)
class Conditioning:
    """Band-pass and integrations of one valve's stream.

    Args:
        sample_period: s.
        low_cut: Hz, below this the high-pass takes away; full pass from twice this on.
        high_cut: Hz, -3 dB point of the low-pass.
        sliding_velocity: m/s, below this relative speed the direction of sliding fades to zero.

    Attributes:
        delay: samples between the newest sample taken and the instant a row describes.
        settling: samples after a restart before the first row is free of the start.

    """

    sample_period: float
    low_cut: float = 3.0
    high_cut: float = 300.0
    sliding_velocity: float = 1.0e-3
    delay: int = field(init=False)
    settling: int = field(init=False)
    _rings: Array = field(init=False)
    _sums: Array = field(init=False)
    _low_rings: Array = field(init=False)
    _low_sums: Array = field(init=False)
    _aligned: Array = field(init=False)
    _scalars: Array = field(init=False)
    _places: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        # A triangle of two means of length n has its first zero at 1 / (n period).
        length = max(3, round(1.0 / (2.0 * self.low_cut * self.sample_period)))
        # sinc^2 is down by 3 dB at 0.319 of its first zero.
        low_length = max(1, round(0.319 / (self.high_cut * self.sample_period)))
        high, low = length - 1, low_length - 1
        # The direction of sliding is the latest channel: velocity, then the whole band-pass again.
        latest = (low + high + 1) + low + 2 * high
        self.delay = latest
        self.settling = latest + 2 * (high + low) + 4
        self._rings = np.zeros((_HIGH_PASS_ROWS, length))
        self._sums = np.zeros(_HIGH_PASS_ROWS)
        self._low_rings = np.zeros((_LOW_PASS_ROWS, low_length))
        self._low_sums = np.zeros(_LOW_PASS_ROWS)
        lags = (low + 2 * high + 2, low + 2 * high + 1, latest, low + 2 * high, low + 2 * high)
        self._aligned = np.zeros((COLUMNS, latest + 1))
        self._scalars = np.zeros(8)
        self._places = np.array([0, 0, 0, *(latest - lag for lag in lags)], dtype=np.int64)

    def reset(self) -> None:
        """Forget every sample: after a gap nothing before it may reach a row."""
        for state in (self._rings, self._sums, self._low_rings, self._low_sums, self._aligned, self._scalars):
            state[:] = 0.0
        self._places[:3] = 0

    def take(self, body: NDArray[np.float32], spool: NDArray[np.float32], rows: Array) -> None:
        """Turn samples of shape (n,), m/s^2, into ``rows`` of shape (n, COLUMNS), in place."""
        _take(
            body, spool, self.sample_period, self.sliding_velocity, self._rings, self._sums,
            self._low_rings, self._low_sums, self._aligned, self._scalars, self._places, rows,
        )  # fmt: skip


@compiled
def _add(window: WindowArrays, gram: Array, score: Array, power: float, samples: float, given: Array) -> None:
    taken, grams, products, powers = window
    place = taken[0] % grams.shape[0]
    taken[0] += 1
    powers[place, 1] = samples
    for i in range(given.size):
        along = 0.0
        for j in range(given.size):
            grams[place, i, j] = gram[i, j]
            along += gram[i, j] * given[j]
        products[place, i] = score[i] + along
        power += given[i] * (2.0 * score[i] + along)
    powers[place, 0] = power


@compiled
def _judge(window: WindowArrays, last: int, given: Array, verdict: Array) -> None:
    """Fill ``verdict`` from the ``last`` chunks: variance of ``given``, of the best fit, samples, the fit."""
    taken, grams, products, powers = window
    size = given.size
    gram = np.zeros((size, size))
    product = np.zeros(size)
    power = 0.0
    samples = 0.0
    for back in range(1, min(taken[0], grams.shape[0], last) + 1):
        place = (taken[0] - back) % grams.shape[0]
        for i in range(size):
            product[i] += products[place, i]
            for j in range(size):
                gram[i, j] += grams[place, i, j]
        power += powers[place, 0]
        samples += powers[place, 1]
    # A singular window is fitted by the smallest parameters that explain it.
    trace = np.trace(gram)
    for i in range(size):
        gram[i, i] += 1e-15 * trace + 1e-300
    verdict[3:] = np.linalg.solve(gram, product)
    tiny = 1e-12 * abs(power) + 1e-300  # chunks of which no sample counts leave nothing
    divisor = max(1.0, samples)
    left = least = power
    for i in range(size):
        least -= verdict[3 + i] * product[i]
        left -= 2.0 * given[i] * product[i]
        for j in range(size):
            left += given[i] * gram[i, j] * given[j]
    verdict[0] = max(left, tiny) / divisor
    verdict[1] = min(float(verdict[0]), max(least, tiny) / divisor)
    verdict[2] = samples


@compiled
def _mean(rings: Array, sums: Array, row: int, place: int, value: float) -> float:
    total: float = sums[row] + value - rings[row, place]
    sums[row] = total
    rings[row, place] = value
    return total / rings.shape[1]


@compiled
def _triangle(rings: Array, sums: Array, row: int, place: int, value: float) -> float:
    return _mean(rings, sums, row + 1, place, _mean(rings, sums, row, place, value))


@compiled
def _high_pass(rings: Array, sums: Array, row: int, place: int, value: float) -> float:
    mean = _triangle(rings, sums, row, place, value)
    following = place + 1
    if following == rings.shape[1]:
        following = 0
    oldest: float = rings[row, following]
    return oldest - mean


@compiled
def _refresh(rings: Array, sums: Array) -> None:
    """Sum the rings again, so that rounding does not grow with run time."""
    for row in range(rings.shape[0]):
        total = 0.0
        for column in range(rings.shape[1]):
            total += rings[row, column]
        sums[row] = total


@compiled
def _take(
    body: NDArray[np.float32],
    spool: NDArray[np.float32],
    period: float,
    sliding_velocity: float,
    rings: Array,
    sums: Array,
    low_rings: Array,
    low_sums: Array,
    aligned: Array,
    scalars: Array,
    places: NDArray[np.int64],
    rows: Array,
) -> None:
    place, low_place, last = places[0], places[1], places[2]
    span = aligned.shape[1]
    # Fourth-order centred integration: error (2 pi f period)^4 11/720 of the amplitude.
    inner, outer = 13.0 * period / 24.0, period / 24.0
    for n in range(body.size):
        # float() of numba keeps single precision.
        of_spool, of_body = np.float64(spool[n]), np.float64(body[n])
        relative = _triangle(low_rings, low_sums, 0, low_place, of_spool - of_body)
        target = _triangle(low_rings, low_sums, 2, low_place, of_spool)
        excitation = _triangle(low_rings, low_sums, 4, low_place, of_body)

        value = _high_pass(rings, sums, 0, place, relative)
        scalars[0] += inner * (scalars[3] + scalars[4]) - outer * (scalars[2] + value)
        scalars[2], scalars[3], scalars[4] = scalars[3], scalars[4], value
        velocity = scalars[0]

        direction = min(1.0, max(-1.0, velocity / sliding_velocity))
        direction = _triangle(low_rings, low_sums, 6, low_place, direction)
        direction = _high_pass(rings, sums, 2, place, direction)
        direction = _high_pass(rings, sums, 4, place, direction)

        velocity = _high_pass(rings, sums, 6, place, velocity)
        scalars[1] += inner * (scalars[6] + scalars[7]) - outer * (scalars[5] + velocity)
        scalars[5], scalars[6], scalars[7] = scalars[6], scalars[7], velocity

        target = _high_pass(rings, sums, 10, place, _high_pass(rings, sums, 8, place, target))
        excitation = _high_pass(rings, sums, 14, place, _high_pass(rings, sums, 12, place, excitation))

        aligned[0, last] = scalars[1]
        aligned[1, last] = velocity
        aligned[2, last] = direction
        aligned[3, last] = target
        aligned[4, last] = excitation
        for column in range(aligned.shape[0]):
            source = last - places[3 + column]
            if source < 0:
                source += span
            rows[n, column] = aligned[column, source]

        last = last + 1 if last + 1 < span else 0
        low_place = low_place + 1 if low_place + 1 < low_rings.shape[1] else 0
        place += 1
        if place == rings.shape[1]:
            place = 0
            _refresh(rings, sums)
            _refresh(low_rings, low_sums)
    places[0], places[1], places[2] = place, low_place, last
