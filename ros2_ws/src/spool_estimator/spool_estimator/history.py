"""History of motion: displacement from accelerations, and what earlier blocks leave.

High-pass and leaky integrators forget their initial state within seconds. Started at zero on a machine that
already runs, they show several times the motion until then. Their initial state is therefore estimated from
the first samples, as the one that leaves the least displacement: any other one adds a slow decay, which
vibration above the low cut does not resemble. Until then the displacement is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.compiled import compiled
from spool_core.numbers import Array

from spool_estimator.identification.spectra import ZeroPhase, relative_motion
from spool_estimator.prediction import (
    BAND_LIMITED,
    COUNT,
    DISTINGUISHING,
    POINTWISE,
    RESIDUAL,
    SUMS,
    Prediction,
    PredictionArrays,
    clear_sums,
    forget_derivatives,
    predict,
)

#: Runs of the model that one descent takes at most, and the relative change of parameters that ends it.
MOST_RUNS, CONVERGED = 14, 1.0e-4
#: Largest relative change of stiffness and viscous coefficient within one step of a descent.
LARGEST_CHANGE = 0.5
#: Ratio of the errors near jumps by which point values and band-limited samples are distinguished.
DISTINGUISHED = 1.5

#: Periods of the low cut from which the initial state is estimated: after four of them the rms of a sine at
#: or above the low cut is within 3 % of the settled one, for any phase.
PERIODS = 4.0
#: States of the filter: means of two high-passes, velocity, displacement.
_ORDER = 4
# Places of the numbers: sample period (s), weights of one step, samples of the start and weight of a chunk
# after it, samples taken, samples in the second half of the start, mean square (m^2).
_PERIOD, _PASS, _LEAK, _START, _SHARE, _TAKEN, _LATE, _MEAN_SQUARE = range(8)


@compiled
def keep(ring: Samples, taken: int, body: Samples, spool: Samples) -> None:
    """Write samples of shape (n,) into ``ring``, shape (2, length), of which ``taken`` came before."""
    place = taken % ring.shape[1]
    for i in range(body.size):
        ring[0, place] = body[i]
        ring[1, place] = spool[i]
        place += 1
        if place == ring.shape[1]:
            place = 0


def newest(ring: Samples, taken: int, count: int) -> tuple[Samples, Samples]:
    """Return the last ``count`` samples of body and spool in ``ring``, fewer where fewer were ``taken``."""
    length = ring.shape[1]
    both = np.roll(ring, -(taken % length), axis=1)[:, length - min(count, taken, length) :]
    return np.ascontiguousarray(both[0]), np.ascontiguousarray(both[1])


@compiled
def sampled_pointwise(pointwise: float, band_limited: float, present: bool) -> bool:
    """Return whether samples are point values, by the squared errors left; else ``present``."""
    if pointwise * DISTINGUISHED < band_limited:
        return True
    return present and not band_limited * DISTINGUISHED < pointwise


class ChunkSums(NamedTuple):
    """Sums of each chunk, see :class:`~.prediction.Prediction`: the first axis counts the chunks."""

    grams: Array
    scores: Array
    sums: Array
    noise_scores: Array


@compiled
def run_chunks(
    body: Samples, spool: Samples, period: float, mass: float, parameters: Array, pointwise: bool, chunk: int,
    run: PredictionArrays, found: ChunkSums
) -> None:  # fmt: skip
    """Run over samples of shape (n,) and fill ``found`` from the last chunks, as many as it has room for.

    The parameters act from the first sample on; samples before the chunks only lead the model into its
    motion.
    """
    forget_derivatives(run.state)
    last = found.sums.shape[0]
    before = body.size - last * chunk
    if before > 0:
        predict(body[:before], spool[:before], period, mass, parameters, pointwise, run)
    for number in range(last):
        clear_sums(run)
        start = before + number * chunk
        predict(
            body[start : start + chunk], spool[start : start + chunk], period, mass, parameters, pointwise,
            run,
        )  # fmt: skip
        found.noise_scores[number] = run.noise_score
        found.grams[number] = run.gram
        found.sums[number] = run.sums
        found.scores[number] = run.product - run.noise_score
    clear_sums(run)


@dataclass(frozen=True, slots=True)
class WindowFit:
    """What the free run fits best to a stretch of samples.

    Attributes:
        parameters: k (N/m), c (N s/m), F_c (N), shape (3,).
        prediction: the model's run at the end of the stretch, ready to go on.
        pointwise: whether the samples are point values, see ``Prediction.take``.
        grams, scores, powers, counts: sums of each chunk that counts, see :class:`~.prediction.Prediction`.
        noise_score: see :class:`~.prediction.Prediction`, of all chunks.

    """

    parameters: Array
    prediction: Prediction
    pointwise: bool
    grams: Array
    scores: Array
    powers: Array
    counts: Array
    noise_score: Array

    @property
    def variance(self) -> float:
        """Mean square of the prediction error, N^2."""
        return float(self.powers.sum() / max(1.0, self.counts.sum()))


@dataclass(frozen=True, slots=True)
class Fitter:
    """Fits the free run to stretches of samples.

    Args:
        like: a run of the valve at this sample rate.
        high_cut: Hz.
        sliding_velocity: m/s, below it the direction of sliding fades to zero, for the start.
        chunk: samples in a chunk.

    """

    like: Prediction
    high_cut: float
    sliding_velocity: float
    chunk: int

    def start(self, body: Samples, spool: Samples) -> Array | None:
        """Return what least squares of the force balance gives, shape (3,), or nothing: a start, biased."""
        conditioning = ZeroPhase(self.like.sample_period, self.like.low_cut, self.high_cut)
        settling = conditioning.settling
        if body.size <= 2 * (settling + self.chunk):
            return None
        both = np.asarray(body, np.float64), np.asarray(spool, np.float64)
        motion = relative_motion(*both, conditioning)
        direction = conditioning.apply(np.clip(motion.velocity / self.sliding_velocity, -1.0, 1.0))
        rows = np.stack((motion.displacement, motion.velocity, direction, motion.spool), axis=1)
        settled: Array = rows[settling:-settling]
        regressors = settled[:, :3] * self.like.scale
        gram = regressors.T @ regressors
        gram[np.diag_indices(3)] *= 1.0 + 1e-9
        if not np.all(np.diag(gram) > 0.0):
            return None
        parameters = np.linalg.solve(gram, -self.like.mass * (regressors.T @ settled[:, 3])) * self.like.scale
        return np.asarray(parameters) if np.all(np.isfinite(parameters)) else None

    def at_rest(self, offset: float) -> Prediction:
        """Return a run that begins at rest, with the body's ``offset`` (m/s^2)."""
        prediction = self.like.copy()
        prediction.reset(offset)
        return prediction

    def run(
        self, body: Samples, spool: Samples, parameters: Array, last: int, pointwise: bool, begin: Prediction
    ) -> WindowFit:
        """Run from where ``begin`` is over whole chunks; the ``last`` ones count."""
        prediction = begin.copy()
        parameters = np.array(parameters)
        grams, sums = np.empty((last, 3, 3)), np.empty((last, SUMS))
        scores, noise_scores = np.empty((last, 3)), np.empty((last, 3))
        run_chunks(
            body, spool, self.like.sample_period, self.like.mass, parameters, pointwise, self.chunk,
            prediction.arrays, ChunkSums(grams, scores, sums, noise_scores),
        )  # fmt: skip
        return WindowFit(
            parameters, prediction,
            sampled_pointwise(float(sums[:, POINTWISE].sum()), float(sums[:, BAND_LIMITED].sum()), pointwise),
            grams, scores, sums[:, RESIDUAL], sums[:, COUNT], noise_scores.sum(axis=0),
        )  # fmt: skip

    def left_by_kinds(
        self, body: Samples, spool: Samples, parameters: Array, last: int, begin: Prediction
    ) -> Array:
        """Return what each kind of filter leaves, one step from ``parameters``, in variances, shape (m,)."""
        present, left = self.like.sharpening.copy(), []
        for sharpening in DISTINGUISHING:
            self.like.sharpening[:] = sharpening
            run = self.run(body, spool, parameters, last, False, begin)
            score = run.scores.sum(axis=0)
            left.append(run.powers.sum() - score @ np.linalg.pinv(run.grams.sum(axis=0)) @ score)
        self.like.sharpening[:] = present
        return np.asarray(np.array(left) / min(left) * float(run.counts.sum()))

    def descend(
        self, body: Samples, spool: Samples, guesses: Sequence[Array], last: int, *, begin: Prediction,
        prior: Array | None = None
    ) -> WindowFit | None:  # fmt: skip
        """Return the best of the descents from ``guesses`` (Levenberg and Marquardt's), or nothing.

        Args:
            body, spool: samples; those before the ``last`` chunks only lead the model into its motion.
            begin: where the model is at the first of them.
            guesses: parameters to start from, each of shape (3,).
            last: how many chunks count.
            prior: diagonal of a weak pull (scaled, N^2) towards the first guess, shape (3,).

        """
        ends = [self._descend(body, spool, guess, guesses[0], last, prior, begin) for guess in guesses]
        best = min(ends, key=lambda end: end.variance if math.isfinite(end.variance) else math.inf)
        if not (math.isfinite(best.variance) and best.parameters[0] > 0.0):
            return None
        if best.pointwise:
            for _ in range(3):  # near the solution: whole steps
                step = np.linalg.pinv(best.grams.sum(axis=0)) @ best.scores.sum(axis=0) * self.like.scale
                trial = self.run(
                    body, spool, best.parameters + self._bounded(step, best.parameters), last, True, begin
                )
                if not trial.variance < 4.0 * best.variance:
                    break
                best = trial
        return best

    def _descend(
        self, body: Samples, spool: Samples, guess: Array, centre: Array, last: int, prior: Array | None,
        begin: Prediction
    ) -> WindowFit:  # fmt: skip
        pull = np.zeros(3) if prior is None else prior

        def cost(end: WindowFit) -> float:
            away = (end.parameters - centre) / self.like.scale
            return float(end.powers.sum() * end.counts.size * self.chunk / end.counts.sum() + pull @ away**2)

        present = self.run(body, spool, guess, last, False, begin)
        damping = 1.0e-3
        for _ in range(MOST_RUNS):
            gram = present.grams.sum(axis=0) + np.diag(pull)
            score = present.scores.sum(axis=0) - pull * (present.parameters - centre) / self.like.scale
            if not np.all(np.isfinite(gram)):
                break
            damped = gram + damping * np.diag(np.diag(gram) + 1e-12 * np.trace(gram) + 1e-30)
            step = self._bounded(np.linalg.solve(damped, score) * self.like.scale, present.parameters)
            trial = self.run(body, spool, present.parameters + step, last, False, begin)
            if trial.parameters[0] > 0.0 and cost(trial) < cost(present):
                present = trial
                damping = max(1e-9, 0.1 * damping)
                if np.all(np.abs(step) < CONVERGED * (np.abs(present.parameters) + 1e-3 * self.like.scale)):
                    break
            else:
                damping *= 10.0
                if damping > 1e4:
                    break
        return present

    def _bounded(self, step: Array, parameters: Array) -> Array:
        room = LARGEST_CHANGE * np.maximum(np.abs(parameters), 0.2 * self.like.scale)
        return step * min(1.0, float(np.min(room / np.maximum(np.abs(step), 1e-300))))


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
    """Travel of the spool in the body: its mean square over about the last second.

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


@compiled
def follow_displacement(samples: Samples, displacement: DisplacementArrays) -> None:
    """Take a chunk of body and spool, shape (2, chunk), m/s^2, into a :class:`Displacement`."""
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
