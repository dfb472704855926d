# A kernel takes numbers and arrays, in one piece:
# ruff: noqa: PLR0912, PLR0915
"""Prediction error of the model run in parallel with the machine, and its derivatives by the parameters.

The body's measured acceleration excites the model; the spool's measured acceleration less the predicted one
is the prediction error, and its derivatives by the parameters are the regressors (recursive prediction error
method: Ljung, System Identification, 1999, ch. 11). Nothing measured is integrated, and a reversal happens in
the model when it happens, not at a sample. Error and derivatives pass one and the same high-pass, so constant
and slowly changing sensor errors vanish.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array
from spool_sim.observation import CAUSAL, LINEAR, MEAN, Observation

from spool_estimator.friction_motion import advance_sample, slip, slip_matrix

#: Samples between the newest one taken and the one that a row describes: four of the ring, one smooths.
DELAY = 5
#: s, the body's mean is taken over windows that double from the first to the last of these.
FIRST_OFFSET, LAST_OFFSET = 0.5, 8.0
#: A point value so near to a jump (in samples) may lie on its other side, and is not used.
AMBIGUOUS = 0.25
#: Largest angle (rad) that the motion turns, or share that it decays, within one Taylor step.
_LARGEST_STEP = 0.4

# Sums over the samples taken since ``clear``.
RESIDUAL, TARGET, BODY, DISPLACEMENT, VELOCITY, COUNT, POINTWISE, BAND_LIMITED, NOISE = range(9)
SUMS = 9
#: What ``mean_squares`` gives, in this order.
MEAN_SQUARES = (RESIDUAL, TARGET, BODY, DISPLACEMENT, VELOCITY)
# Places in the memory, the last part of the state, see ``_parts``.
_SEEN, _LAST_JUMP, _OFFSET, _WINDOW, _TAKEN, _WEIGHT, _WEIGHTED, _POINT, _V, _Z = range(10)
_MEMORY, _STATES = 61, 71


#: Kinds of filters of loggers that are distinguished; the first stands for sharp ones without phase.
KINDS = (
    Observation(), Observation(MEAN), Observation(LINEAR, 3.0, 0.36),
    *(Observation(CAUSAL, order, corner) for order in (2.0, 4.0, 8.0) for corner in (0.3, 0.36, 0.44)),
)  # fmt: skip


# Of six samples: for the third of the first five, halfway between third and fourth, for the second.
_PLACES = (np.arange(-2.0, 3.0), np.arange(-2.5, 3.0), np.arange(-1.0, 5.0))


def _sharpening(kind: Observation, flats: tuple[int, ...]) -> Array:
    """Return weights of samples that take off the filter of ``kind``, shape (17,).

    Least squares over the spectrum of a jump, smoothed as errors are, over ``flats`` powers of the frequency.
    """
    frequency, rows = np.arange(1, 512) / 1024.0, []
    for nodes, flat in zip(_PLACES, flats, strict=True):
        weight = np.cos(np.pi * frequency) ** 2 / frequency ** (1 + flat)
        waves = np.exp(2j * np.pi * np.outer(nodes, frequency)) * kind.response(frequency) * weight
        rows.append(weight @ np.linalg.pinv(np.hstack((waves.real, waves.imag)))[: weight.size])
    return np.hstack(rows)


#: Weights of the body's samples at the ends and in the middle of a step, and of the spool's samples, that
#: take off the filter of each kind, shape (m, 17): next to jumps, which distinguish kinds, and of motion.
DISTINGUISHING, SHARPENINGS = (
    np.array([_sharpening(kind, flats) for kind in KINDS]) for flats in ((2, 2, 0), (2, 2, 1))
)
DISTINGUISHING[0] = SHARPENINGS[0] = 0.0


class PredictionArrays(NamedTuple):
    """Arrays of a :class:`Prediction`, which kernels move on in place."""

    constants: Array
    state: Array
    gram: Array
    product: Array
    sums: Array
    noise_score: Array
    mean_squares: Array
    sharpening: Array


@dataclass(slots=True)
class Prediction:
    """One valve's model run in parallel, and the sums of least squares since ``clear``.

    Args:
        sample_period: s.
        mass: kg, moving mass.
        scale: what a parameter's derivative is multiplied by, shape (3,): k (N/m), c (N s/m), F_c (N).
        low_cut: Hz, -3 dB point of the high-pass.
        sharpening: one of SHARPENINGS, by the logger's filter; shared by copies.

    Attributes:
        gram, product: sums of derivatives times derivatives and times the error, N^2, scaled.
        noise_score: what noise of the body's sensor makes of ``product`` on average, shape (3,), N^2, scaled.
        sums: of squares: error and target (N), body (m/s^2), displacement (m) and velocity (m/s) as
            measured; their count; error next to jumps taken as point values and as band-limited ones
            (m/s^2); noise of the body's acceleration (m/s^2).
        mean_squares: of MEAN_SQUARES in this order, shape (5,).
        state: where the run is now, the model's motion (see :mod:`.friction_motion`) first; ``at`` goes on
            from a copy of it.

    """

    sample_period: float
    mass: float
    scale: Array
    low_cut: float = 4.0
    sharpening: Array = field(default_factory=SHARPENINGS[0].copy)
    gram: Array = field(init=False)
    product: Array = field(init=False)
    noise_score: Array = field(init=False)
    sums: Array = field(init=False)
    mean_squares: Array = field(init=False)
    state: Array = field(init=False)
    _constants: Array = field(init=False)

    def __post_init__(self) -> None:
        self.gram, self.product, self.sums = np.zeros((3, 3)), np.zeros(3), np.zeros(SUMS)
        self.noise_score, self.mean_squares = np.zeros(3), np.zeros(len(MEAN_SQUARES))
        self.state = np.zeros(_STATES)
        period = self.sample_period
        # Two equal first-order stages are down by 3 dB together at 1.554 times the corner of one.
        corner = self.low_cut / 1.554
        self._constants = np.array(
            [
                1.0 - math.exp(-2.0 * math.pi * corner * period),
                math.exp(-0.25 * math.pi * self.low_cut * period),
                round(FIRST_OFFSET / period),
                round(LAST_OFFSET / period),
                *self.scale,
            ]
        )

    @property
    def offset(self) -> float:
        """What is taken off the body's acceleration, m/s^2; NaN before the first sample."""
        offset, window = self.state[_MEMORY + _OFFSET], self.state[_MEMORY + _WINDOW]
        return float(offset) if window > 0.0 else math.nan

    def reset(self, offset: float = math.nan) -> None:
        """Forget every sample: the model starts at rest, with the body's ``offset`` where it is known."""
        self.state.fill(0.0)
        if math.isfinite(offset):
            self.state[_MEMORY + _OFFSET] = offset
            self.state[_MEMORY + _WINDOW] = self._constants[3]
        self.clear()

    def copy(self) -> Prediction:
        """Return a run that goes on from here by itself, its sums begun again."""
        return self.at(self.state)

    def at(self, state: Array) -> Prediction:
        """Return a run that goes on from ``state`` by itself, its sums begun again."""
        other = Prediction(self.sample_period, self.mass, self.scale, self.low_cut, self.sharpening)
        other.state[:] = state
        return other

    def clear(self) -> None:
        """Begin the sums again."""
        clear_sums(self.arrays)

    @property
    def arrays(self) -> PredictionArrays:
        """What the kernels move on in place."""
        return PredictionArrays(
            self._constants, self.state, self.gram, self.product, self.sums, self.noise_score,
            self.mean_squares, self.sharpening,
        )  # fmt: skip

    def take(self, body: Samples, spool: Samples, parameters: Array, *, pointwise: bool = False) -> None:
        """Run over samples of shape (n,), m/s^2, with k (N/m), c (N s/m), F_c (N), shape (3,).

        ``pointwise``: samples are point values of the spool's acceleration; else the sensor's output is
        band-limited before it is sampled, as a data logger does.
        """
        predict(body, spool, self.sample_period, self.mass, parameters, pointwise, self.arrays)


@compiled
def forget_derivatives(state: Array) -> None:
    """Take the motion so far as given: the parameters act from here on."""
    motion, _, spread, smooth, means, _ = _parts(state)
    motion[3:] = 0.0
    spread[1:] = 0.0
    smooth[1:4] = 0.0
    means[1:4] = 0.0


@compiled
def score_noise(
    sums: Array, parameters: Array, scale: Array, mass: float, period: float, pointwise: bool, score: Array
) -> None:
    """Fill ``score`` with what noise of the body's sensor makes of ``product`` on average.

    The model answers to that noise, the spool does not: least squares would rather damp the answer
    (errors in the input: Soederstroem, Automatica 43 (2007) 939). For white noise of variance q the
    answer's mean square is q T (d^2 + k m) / (2 d m), d being the damping; half its slope is the mean
    score. Dry friction damps a small motion upon a large one of rms V like 2 F_c / (pi sqrt(2) V).
    """
    score[:] = 0.0
    if sums[COUNT] == 0.0 or sums[VELOCITY] == 0.0:
        return
    k, c, f = abs(parameters[0]), parameters[1], abs(parameters[2])
    by_friction = math.sqrt(2.0) / (math.pi * math.sqrt(sums[VELOCITY] / sums[COUNT]))
    damping = max(c + by_friction * f, 1e-3 * scale[1])
    # Sensors are alike: the body's noise is no more than the prediction leaves, 3/8 of it once smoothed.
    left = sums[RESIDUAL] / mass**2 * (1.0 if pointwise else 8.0 / 3.0)
    size = 0.5 * mass**2 * min(sums[NOISE], left) * period
    by_damping = size * (k / (2.0 * damping**2) - 1.0 / (2.0 * mass))
    score[0] = -size / (2.0 * damping) * scale[0]
    score[1] = by_damping * scale[1]
    score[2] = by_damping * by_friction * scale[2]


@compiled
def clear_sums(run: PredictionArrays) -> None:
    """Begin the sums of a prediction again."""
    run.gram[:] = 0.0
    run.product[:] = 0.0
    run.sums[:] = 0.0


@compiled
def shift(motion: Array, change: Array) -> None:
    """Move ``motion`` to where it would be with k, c, F_c changed by ``change``, to first order."""
    motion[0] += motion[3] * change[0] + motion[5] * change[1] + motion[7] * change[2]
    if motion[2] != 0.0:
        motion[1] += motion[4] * change[0] + motion[6] * change[1] + motion[8] * change[2]
        motion[2] = math.copysign(1.0, motion[1])


@compiled
def predict(
    body: Samples, spool: Samples, period: float, mass: float, parameters: Array, pointwise: bool,
    run: PredictionArrays
) -> None:  # fmt: skip
    """Run over samples as :class:`Prediction` does, whose arrays ``run`` holds."""
    constants, state, gram, product, sums, noise_score, mean_squares, sharpening = run
    k, c, f = parameters[0], parameters[1], parameters[2]
    per_mass = 1.0 / mass
    fastest = max(math.sqrt(abs(k) * per_mass), abs(c) * per_mass)
    pieces = min(1000, math.ceil(max(1.0, fastest * period / _LARGEST_STEP)))
    motion, ring, spread, smooth, means, memory = _parts(state)
    share, leak = constants[0], constants[1]
    to_k, to_c, to_f = -mass * constants[4], -mass * constants[5], -mass * constants[6]
    sharpened = not pointwise and sharpening[0] != 0.0
    matrix = np.empty((8, 8))
    slip_matrix(period, mass, parameters, matrix)
    for n in range(body.size):
        for i in range(5):
            ring[0, i] = ring[0, i + 1]
            ring[1, i] = ring[1, i + 1]
        memory[_SEEN] += 1.0
        # float() of numba keeps single precision.
        ring[0, 5] = _less_offset(memory, np.float64(body[n]), constants[2], constants[3])
        ring[1, 5] = np.float64(spool[n])
        if memory[_SEEN] < 6.0:
            continue
        a0, a1, spool_then = ring[0, 2], ring[0, 3], ring[1, 1]
        # Halfway between samples by the polynomial of degree 5.
        am = (150.0 * (a0 + a1) - 25.0 * (ring[0, 1] + ring[0, 4]) + 3.0 * (ring[0, 0] + ring[0, 5])) / 256.0
        if sharpened:
            a0, am, a1, spool_then = _sharpened(ring, sharpening)
        predicted, by_k, by_c, by_f = _acceleration(motion, a0, k, c, f, per_mass)
        spread[0, 1] += predicted
        spread[1, 1] += by_k
        spread[2, 1] += by_c
        spread[3, 1] += by_f
        near = memory[_LAST_JUMP] > 1.0 - AMBIGUOUS
        first, last = 2.0, -2.0
        if not (pieces == 1 and slip(motion, a0, am, a1, matrix)):
            first, last = advance_sample(motion, a0, am, a1, period, pieces, mass, parameters, spread)
        memory[_LAST_JUMP] = last
        near = near or first < AMBIGUOUS

        error = spool_then - spread[0, 0]
        point_error = memory[_POINT]
        memory[_POINT] = ring[1, 2] - predicted
        if memory[_SEEN] < 10.0:
            # The filters begin with the first whole row, as if it had been there always.
            smooth[0, :] = smooth[4, :] = means[0, 0] = memory[_POINT]
            means[6, 0] = ring[1, 2] - ring[0, 2]
        error = _smoothed(smooth, 0, error)
        row_k = _smoothed(smooth, 1, spread[1, 0])
        row_c = _smoothed(smooth, 2, spread[2, 0])
        row_f = _smoothed(smooth, 3, spread[3, 0])
        point_error = _smoothed(smooth, 4, point_error)
        for i in range(4):
            for j in range(3):
                spread[i, j] = spread[i, j + 1]
            spread[i, 3] = 0.0
        constant = means[0, 0] + means[0, 1]
        if point_error != error:  # next to a jump
            sums[POINTWISE] += (point_error - constant) ** 2
            sums[BAND_LIMITED] += (error - constant) ** 2
        _add_signals(ring, means, memory, share, leak, period, a0, mass, predicted, sums)
        if pointwise:
            if near:
                continue
            error, row_k, row_c, row_f = memory[_POINT], by_k, by_c, by_f
        error = -mass * _high_pass(means, 0, share, error)
        row_k = to_k * _high_pass(means, 1, share, row_k)
        row_c = to_c * _high_pass(means, 2, share, row_c)
        row_f = to_f * _high_pass(means, 3, share, row_f)
        _add_row(gram, product, row_k, row_c, row_f, error)
        sums[RESIDUAL] += error * error
    for i in range(3):
        for j in range(i):
            gram[i, j] = gram[j, i]
    score_noise(sums, parameters, constants[4:7], mass, period, pointwise, noise_score)
    for place in range(mean_squares.size):
        mean_squares[place] = sums[MEAN_SQUARES[place]] / max(1.0, sums[COUNT])


@compiled
def _parts(state: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return views of ``state``: motion, ring of samples, spread jumps, smoothing, high-passes, memory."""
    return (
        state[:9],
        state[9:21].reshape(2, 6),
        state[21:37].reshape(4, 4),
        state[37:47].reshape(5, 2),
        state[47:_MEMORY].reshape(7, 2),
        state[_MEMORY:],
    )


@compiled
def _sharpened(ring: Array, weights: Array) -> tuple[float, float, float, float]:
    """Return the body's acceleration at both ends of a step and halfway, and the spool's, unfiltered."""
    a0 = a1 = 0.0
    am, spool = weights[10] * ring[0, 5], weights[16] * ring[1, 5]
    for i in range(5):
        a0 += weights[i] * ring[0, i]
        a1 += weights[i] * ring[0, i + 1]
        am += weights[5 + i] * ring[0, i]
        spool += weights[11 + i] * ring[1, i]
    return a0, am, a1, spool


@compiled
def _acceleration(
    motion: Array, body: float, k: float, c: float, f: float, per_mass: float
) -> tuple[float, float, float, float]:
    """Return the model's acceleration, m/s^2, and its derivatives by k, c, F_c; it sticks to the ``body``."""
    if motion[2] == 0.0:
        return body, 0.0, 0.0, 0.0
    return (
        -(k * motion[0] + c * motion[1] + motion[2] * f) * per_mass,
        -(k * motion[3] + c * motion[4] + motion[0]) * per_mass,
        -(k * motion[5] + c * motion[6] + motion[1]) * per_mass,
        -(k * motion[7] + c * motion[8] + motion[2]) * per_mass,
    )


@compiled
def _add_signals(
    ring: Array, means: Array, memory: Array, share: float, leak: float, period: float, body: float,
    mass: float, predicted: float, sums: Array
) -> None:  # fmt: skip
    """Add the squares of what a sample shows by itself: excitation, motion, force of the model, noise."""
    memory[_V] = leak * memory[_V] + period * _high_pass(means, 6, share, ring[1, 2] - ring[0, 2])
    memory[_Z] = leak * memory[_Z] + period * memory[_V]
    sums[VELOCITY] += memory[_V] * memory[_V]
    sums[DISPLACEMENT] += memory[_Z] * memory[_Z]
    excitation = _high_pass(means, 4, share, body)
    sums[BODY] += excitation * excitation
    target = mass * _high_pass(means, 5, share, predicted)
    sums[TARGET] += target * target
    sums[COUNT] += 1.0
    # The fifth difference of a slow signal is that of its white noise: 1 + 25 + 100 + 100 + 25 + 1 = 252.
    rough = ring[0, 5] - ring[0, 0] + 5.0 * (ring[0, 1] - ring[0, 4]) + 10.0 * (ring[0, 3] - ring[0, 2])
    sums[NOISE] += rough * rough / 252.0


@compiled
def _add_row(gram: Array, product: Array, k: float, c: float, f: float, error: float) -> None:
    """Add one row of least squares: derivatives by three parameters, and the error."""
    gram[0, 0] += k * k
    gram[0, 1] += k * c
    gram[0, 2] += k * f
    gram[1, 1] += c * c
    gram[1, 2] += c * f
    gram[2, 2] += f * f
    product[0] += k * error
    product[1] += c * error
    product[2] += f * error


@compiled
def _high_pass(means: Array, row: int, share: float, value: float) -> float:
    first = value - means[row, 0]
    means[row, 0] += share * first
    second: float = first - means[row, 1]
    means[row, 1] += share * second
    return second


@compiled
def _smoothed(smooth: Array, row: int, value: float) -> float:
    """Return the mean of three values weighed 1, 2, 1: above that, samplers differ most."""
    mean: float = 0.25 * (smooth[row, 0] + 2.0 * smooth[row, 1] + value)
    smooth[row, 0] = smooth[row, 1]
    smooth[row, 1] = value
    return mean


@compiled
def _less_offset(memory: Array, value: float, first: float, last: float) -> float:
    """Return ``value`` less the mean of an earlier window, weighed by a triangle.

    The offset stays as it is within a window: a mean that followed would lead the signal in phase.
    """
    if memory[_WINDOW] == 0.0:
        memory[_OFFSET] = value
        memory[_WINDOW] = first
    memory[_TAKEN] += 1.0
    half = 0.5 * memory[_WINDOW]
    weight = half - abs(memory[_TAKEN] - half)
    memory[_WEIGHT] += weight
    memory[_WEIGHTED] += weight * value
    if memory[_TAKEN] >= memory[_WINDOW]:
        memory[_OFFSET] = memory[_WEIGHTED] / memory[_WEIGHT]
        memory[_TAKEN] = memory[_WEIGHT] = memory[_WEIGHTED] = 0.0
        memory[_WINDOW] = min(2.0 * memory[_WINDOW], last)
    less: float = value - memory[_OFFSET]
    return less
