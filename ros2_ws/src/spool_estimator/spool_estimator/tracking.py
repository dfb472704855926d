"""Tracking of parameters: least squares of prediction errors with forgetting, and restarts."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_core.block import Samples
from spool_core.kernels.samples import StandingWatch
from spool_core.numbers import Array
from spool_core.system import BUDGET

from spool_estimator import chunks
from spool_estimator.history import Displacement, Fitter, WindowFit, newest
from spool_estimator.prediction import BODY, KINDS, MEAN_SQUARES, SHARPENINGS, Prediction
from spool_estimator.recursive import CERTAIN, COLOURED, RecursiveLeastSquares
from spool_estimator.sliding_window import ChunkWindow

#: s of samples that are kept for starts.
KEPT = 3.0
#: The past is thrown away only for a parameter that changed by its share here, and by so many deviations;
#: their squares are those for white errors times COLOURED, as a resonance colours them.
NOTABLE = (0.01, 0.05, 0.05)
#: A refit has to leave less than this share of the residual power to be believed.
BETTER = 0.85
#: Relative standard deviation that a change of a parameter is believed to have.
LARGEST_STEP = 0.5
#: Relative standard deviation of the stiffness that a start must reach.
STARTED = 0.1
#: Force that no estimate is better than: share of the inertia force that the pair of sensors and the sampling
#: of the excitation are believed to, and shares of F_c that the shape of a band-limited or point jump leaves.
MATCHED, JUMP_SHAPE, POINT_SHAPE = 1.5e-4, 1.5e-3, 1.0e-4
#: The latter where noise hides which of both the samples are, per second of sample period.
UNTOLD_SHAPE = 15.0


#: Fields of chunks.PROGRESS that a tracker keeps in its knowledge.
KNOWN = ["started", "pointwise", "distinguished", "by_points", "band_limited", "least"]


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Copy of the learned state of a tracker; the fields are those of the tracker.

    ``offset`` (m/s^2) is that of its prediction, ``progress`` holds the fields of KNOWN.
    """

    regression: RecursiveLeastSquares
    offset: float
    powers: Array
    sizes: Array
    typical: Array
    left: Array
    progress: tuple[bool | float, ...]


@dataclass(slots=True)
class Tracker:
    """Follows k (N/m), c (N s/m) and F_c (N) of one valve from its samples, chunk by chunk.

    Args:
        sample_period: s.
        mass: kg.
        scale: orders of magnitude of the parameters, shape (3,).
        memory: s, time constant of forgetting.
        low_cut, high_cut: Hz, the band.
        sliding_velocity: m/s, see :class:`~.history.Fitter`.
        minimum_excitation: m/s^2, rms body acceleration below which parameters are held.

    Attributes:
        powers: mean squares over the last second or so: error, inertia force (N), body acceleration (m/s^2),
            displacement (m), velocity (m/s); NaN before the first. Displacement and velocity start at zero
            and settle within seconds; they only weigh deviations.
        chunk: samples in a chunk.
        filled: samples that wait for their chunk to be full.
        displacement: the spool's in the body, unknown until its start is estimated.
        refits: how often the model was fitted again to the last samples.
        standing: whether the channels change; of a chunk in which they do not nothing is learned.
        sharpening: what takes off the logger's filter, see :class:`~.prediction.Prediction`.

    """

    sample_period: float
    mass: float
    scale: Array
    memory: float
    low_cut: float
    high_cut: float
    sliding_velocity: float
    minimum_excitation: float
    regression: RecursiveLeastSquares = field(init=False)
    prediction: Prediction = field(init=False)
    chunk: int = field(init=False)
    filled: int = field(default=0, init=False)
    powers: Array = field(init=False)
    displacement: Displacement = field(init=False)
    refits: int = field(default=0, init=False)
    standing: StandingWatch = field(init=False)
    _progress: NDArray[np.void] = field(default_factory=lambda: np.zeros(1, chunks.PROGRESS), init=False)
    _waiting: Samples = field(init=False)
    _ring: Samples = field(init=False)
    _fitter: Fitter = field(init=False)
    _window: ChunkWindow = field(init=False)
    _earlier: Array = field(init=False)
    _typical: Array = field(init=False)
    _verdicts: Array = field(init=False)
    _scales: Array = field(init=False)
    _nominal: Array = field(init=False)
    _sizes: Array = field(init=False)
    sharpening: Array = field(init=False)
    _left: Array = field(init=False)
    _valve: chunks.Valve = field(init=False)
    _patience: int = field(default=5, init=False)

    def __post_init__(self) -> None:
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes = np.zeros(len(MEAN_SQUARES))
        self.regression = self._fresh()
        self._scales = self.scale[:, np.newaxis] * self.scale
        self._nominal = self.scale * np.array([1.0, 1.0, 0.2])
        self._window = ChunkWindow(self.scale)
        self._typical = np.full(len(chunks.LENGTHS), chunks.SIGNIFICANT / chunks.ATYPICAL)
        self._verdicts = np.zeros((len(chunks.LENGTHS), 3 + self.scale.size))
        self._progress["settling"] = True
        self._progress["least"] = math.inf
        self._progress["allowed"] = chunks.MOST_REFITS
        self.set_period(self.sample_period)

    @property
    def started(self) -> bool:
        """Whether the parameters are those of a fit."""
        return bool(self._progress["started"][0])

    @property
    def excited(self) -> bool:
        """Whether the last chunk was excited."""
        return bool(self._progress["excited"][0])

    @property
    def settling(self) -> bool:
        """Whether the motion was settling in the last chunk."""
        return bool(self._progress["settling"][0])

    @property
    def used(self) -> int:
        """Samples of the chunks taken last from which was learned."""
        return int(self._progress["used"][0])

    def set_period(self, sample_period: float) -> None:
        """Go on with samples of another period (s): what was learned is kept."""
        self.sample_period = sample_period
        self.chunk = max(8, round(chunks.CHUNK / sample_period))
        self._waiting = np.empty((2, self.chunk), np.float32)
        self.standing = StandingWatch(sample_period)
        self.sharpening, self._left = SHARPENINGS[0].copy(), np.zeros(len(KINDS))
        self.prediction = Prediction(sample_period, self.mass, self.scale, self.low_cut, self.sharpening)
        self.displacement = Displacement(sample_period, self.low_cut, self.chunk, chunks.CHUNK)
        self._progress["pointwise"] = False
        self._ring = np.zeros((2, round(KEPT / chunks.CHUNK) * self.chunk), np.float32)
        self._fitter = Fitter(self.prediction, self.high_cut, self.sliding_velocity, self.chunk)
        self._earlier = np.zeros((max(chunks.LENGTHS), self.prediction.state.size))
        self._valve = chunks.Valve(
            sample_period, self.mass, min(1.0, chunks.CHUNK / self.memory), self.minimum_excitation**2,
            chunks.RAN_AWAY * self.mass**2,
        )  # fmt: skip

    def knowledge(self) -> Knowledge:
        """Return what is known now, for ``restore``."""
        return Knowledge(
            self.regression.copy(), self.prediction.offset, self.powers.copy(), self._sizes.copy(),
            self._typical.copy(), self._left.copy(), self._progress[KNOWN][0].item(),
        )  # fmt: skip

    def restore(self, known: Knowledge | None) -> None:
        """Go back to what was ``known``, or to nothing, and begin the motion again."""
        if known is None:
            self._forget()
            return
        self.regression = known.regression.copy()
        self.powers, self._sizes = known.powers.copy(), known.sizes.copy()
        self._typical = known.typical.copy()
        self._prefer_kind(known.left)
        self._progress[KNOWN] = known.progress
        self.prediction.reset(known.offset)
        self.restart()

    def begin(self) -> None:
        """Begin again after a gap: what was learned is kept, the newest samples are not."""
        self.standing.reset()
        self.restart()

    def restart(self) -> None:
        """Begin the motion again: what was learned is kept."""
        self.prediction.reset(self.prediction.offset if self.started else math.nan)
        self.powers[MEAN_SQUARES.index(BODY)] = math.nan
        self.displacement.reset()
        self._window.clear()
        self.filled = 0
        self._progress[["earlier", "since_restart", "pause"]] = 0
        self._patience = 5

    def take(self, body: Samples, spool: Samples, most: int = 1) -> tuple[int, int]:
        """Take samples of shape (n,), m/s^2, up to the end of ``most`` chunks, or of one that is not regular.

        Returns:
            How many samples were taken, and how many chunks became full.

        """
        filled, progress = self.filled, self._progress
        if filled + body.size < self.chunk:
            self._waiting[0, filled : filled + body.size] = body
            self._waiting[1, filled : filled + body.size] = spool
            self.filled = filled + body.size
            return body.size, 0
        try:
            learning = chunks.Learning(
                self._valve, self._arrays, self.standing.arrays, self.displacement.arrays,
                self.prediction.arrays, self._window.arrays, self.regression.arrays,
            )  # fmt: skip
            need = chunks.follow(body, spool, filled, most, learning)
            self.filled = (filled + int(progress["taken"][0])) % self.chunk
            self._finish_chunk(need)
        except (np.linalg.LinAlgError, ZeroDivisionError):
            # Channels of no passive valve, exchanged or dead ones, lead to sums that overflow or vanish.
            self._forget()
        return int(progress["taken"][0]), int(progress["chunks"][0])

    def _finish_chunk(self, need: int) -> None:
        if need == chunks.Need.NOTHING:
            return
        if need == chunks.Need.STANDSTILL:
            self._progress["excited"], self._progress["settling"] = False, True
            self.restart()
            return
        if need == chunks.Need.FORGETTING:
            self._forget()
            return
        if need == chunks.Need.START:
            self._start(math.inf)
        elif need == chunks.Need.REFIT and not self._replaced():
            need = chunks.step(self._valve, self._arrays, self.prediction.arrays, self.regression.arrays)
        if need == chunks.Need.REGRESSION:
            self._progress["started"] = False
            self.regression = self._fresh()
        chunks.end_chunk(self._arrays, self.prediction.arrays)

    def _replaced(self) -> bool:
        """Refit, or start again, where the last chunks ask for it; return whether that is better."""
        arrays, window = self._arrays, self._window.arrays
        for which in range(len(chunks.LENGTHS)):
            wanted, usual = chunks.wants_refit(which, arrays, window), float(self._typical[which])
            chunks.learn_gain(which, arrays, window)
            if wanted and BUDGET.allows():
                begun = time.thread_time()
                better = self._refit(which, usual)
                BUDGET.spend(time.thread_time() - begun)
                if better:
                    return True
        poor, self._progress["least"] = chunks.fits_poorly(arrays), chunks.least_left(arrays)
        return poor and self._start(0.5 * float(self._verdicts[-1, 0]))

    @property
    def _arrays(self) -> chunks.TrackerArrays:
        return chunks.TrackerArrays(
            self._progress, self._waiting, self._ring, self.powers, self._sizes, self._typical,
            self._earlier, self._verdicts, self.scale, self._nominal,
        )  # fmt: skip

    @property
    def systematic(self) -> Array:
        """Standard deviations that no amount of data removes, shape (3,)."""
        shape = POINT_SHAPE if self._progress["pointwise"][0] else JUMP_SHAPE
        if not self._progress["distinguished"][0]:
            shape = UNTOLD_SHAPE * self.sample_period
        _, target, _, displacement, velocity = (
            math.sqrt(max(power, 1e-20)) for power in self._sizes.tolist()
        )
        force = math.hypot(MATCHED * target, shape * float(self.regression.parameters[2]))
        return np.array([force / displacement, force / velocity, force])

    @property
    def covariance(self) -> Array:
        """Covariance of k, c, F_c, shape (3, 3): of the regression, and what no amount of data removes."""
        bias, leaks = self.regression.bias, self.regression.leaks * (1.0 - np.eye(self.scale.size))
        chance = (self.regression.covariance + bias[:, np.newaxis] * bias + leaks @ leaks.T) * self._scales
        chance.reshape(-1)[:: self.scale.size + 1] += self.systematic**2  # the diagonal
        return np.asarray(chance)

    def _fresh(self) -> RecursiveLeastSquares:
        return RecursiveLeastSquares(self.scale, min(1.0, chunks.CHUNK / self.memory), chunks.NOISE)

    def _forget(self) -> None:
        """Begin with nothing known: what was learned does not describe anything."""
        self._progress[["started", "excited", "settling", "pointwise"]] = False, False, True, False
        self._progress[["by_points", "band_limited"]] = 0.0
        self._prefer_kind(np.zeros(len(KINDS)))
        self.regression = self._fresh()
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes = np.zeros(len(MEAN_SQUARES))
        self.restart()

    def _start(self, present: float) -> bool:
        """Fit to all samples that are kept; believe it where it leaves less than ``present`` (N^2)."""
        self._progress["pause"] = self._patience
        self._patience = min(self._patience + 1, 100)
        body, spool = self._newest(self._ring.shape[1])
        first = self._fitter.start(body, spool)
        guesses = [self._nominal] if first is None or first[0] <= 0.0 else [first, self._nominal]
        if self.started:
            guesses.append(self.regression.parameters)
        settling = chunks.settling_chunks(self._valve, self._arrays, self.regression.arrays)
        last = body.size // self.chunk - settling
        offset = float(np.average(body, weights=np.hanning(body.size + 2)[1:-1]))
        found = self._fitter.descend(body, spool, guesses, last, begin=self._fitter.at_rest(offset))
        if found is None or not found.variance < BETTER * present:
            return False
        kinds = self._left
        if self._learn_kind((body, spool), found, last, self._fitter.at_rest(offset)):
            guesses, begin = [found.parameters, *guesses], self._fitter.at_rest(offset)
            found = self._fitter.descend(body, spool, guesses, last, begin=begin) or found
        former, self.regression = self.regression, self._fresh()
        self._begin(found)
        if self.regression.standard_deviations[0] > STARTED * found.parameters[0]:
            self.regression = former
            self._prefer_kind(kinds)
            return False
        self._adopt(found)
        self._progress["started"] = True
        self._patience = 5
        return True

    def _refit(self, which: int, usual: float) -> bool:
        """Fit to the last chunks, weakly held to what was known; believe it where it is clearly better.

        ``usual``: what such a refit gained usually until now, in residual variances.
        """
        now, last, present = self._progress[0], chunks.LENGTHS[which], float(self._verdicts[which, 0])
        now["allowed"] -= 1.0
        if which == len(chunks.LENGTHS) - 1 and now["check"] <= 0:
            now["check"] = now["between"] = min(chunks.LAST_CHECK, 2 * now["between"])
        known = self.regression.parameters
        if now["earlier"] < last:
            return False
        body, spool = self._newest(last * self.chunk)
        begin = self._earlier[(now["earlier"] - last) % len(self._earlier)]
        # Dry friction makes local minima: it is tried from both sides.
        guesses = [known, known * np.array([1.0, 1.0, 1.25]), known * np.array([1.0, 1.0, 0.75])]
        best = self._window.best(last)
        if 0.1 < best[0] / known[0] < 10.0 and best[1] > 0.0:
            guesses.append(best)
        width = LARGEST_STEP * np.maximum(np.abs(known) / self.scale, 0.2)
        found = self._fitter.descend(
            body, spool, guesses, last, begin=self.prediction.at(begin), prior=present / width**2
        )
        if which == len(chunks.LENGTHS) - 1 and now["between"] < chunks.LAST_CHECK and found is not None:
            self._learn_kind((body, spool), found, last, self.prediction.at(begin))
        if found is None or not found.variance < BETTER * present:
            return False
        information = found.grams.sum(axis=0) / (found.variance * max(COLOURED, usual))
        deviation = np.sqrt(np.abs(np.diag(np.linalg.pinv(information)))) * self.scale
        notable = np.array(NOTABLE) * np.maximum(np.abs(known), 0.1 * self.scale)
        if np.all(np.abs(found.parameters - known) < np.maximum(notable, CERTAIN * deviation)):
            return False
        self._begin(found)
        self._adopt(found)
        return True

    def _learn_kind(
        self, samples: tuple[Samples, Samples], found: WindowFit, last: int, at: Prediction
    ) -> bool:
        """Learn the kind of the logger's filter where ``found`` was fitted; return whether it changed."""
        if found.pointwise:
            return False
        left = self._fitter.left_by_kinds(*samples, found.parameters, last, at)
        return self._prefer_kind(self._left + left)

    def _prefer_kind(self, left: Array) -> bool:
        """Take the kind of filter that left least in all, shape (m,); return whether it changed."""
        before, self._left = int(np.argmin(self._left)), left.copy()
        self.sharpening[:] = SHARPENINGS[np.argmin(left)]
        return before != int(np.argmin(left))

    def _newest(self, count: int) -> tuple[Samples, Samples]:
        return newest(self._ring, int(self._progress["since_restart"][0]) * self.chunk, count)

    def _begin(self, found: WindowFit) -> None:
        weight = chunks.NOISE**2 / (found.variance + chunks.SMALLEST_NOISE**2)
        doubt = chunks.DOUBT * weight * found.noise_score
        self.regression.begin(found.parameters, found.grams * weight, found.scores * weight, doubt)

    def _adopt(self, found: WindowFit) -> None:
        """Go on with the motion of ``found``, and judge the chunks from now on by it."""
        self.prediction = found.prediction
        self.powers[0] = found.variance
        now = self._progress[0]
        now["pointwise"] = found.pointwise
        now["check"] = now["between"] = chunks.FIRST_CHECK
        self._window.clear()
        for gram, score, power, count in zip(
            found.grams, found.scores, found.powers, found.counts, strict=True
        ):
            self._window.add_sums(gram, score, float(power), float(count), found.parameters)
        self.refits += 1
