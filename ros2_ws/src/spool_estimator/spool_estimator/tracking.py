"""Tracking of parameters: least squares of prediction errors with forgetting, and restarts."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.samples import StandingWatch
from spool_core.numbers import Array

from spool_estimator import chunks
from spool_estimator.chunks import LENGTHS, NOISE, SMALLEST_NOISE
from spool_estimator.history import Displacement, Fitter, History, WindowFit
from spool_estimator.prediction import BODY, MEAN_SQUARES, Prediction
from spool_estimator.recursive import ENOUGH, RecursiveLeastSquares, SlidingLeastSquares
from spool_estimator.sliding_window import ChunkWindow
from spool_estimator.stream_estimator import CHUNK

#: s of samples that are kept for starts.
KEPT = 3.0
#: The past is thrown away only for a parameter that changed by its share here, and by so many deviations;
#: their squares are those for white errors times COLOURED, as a resonance colours them.
NOTABLE, CERTAIN, COLOURED = (0.01, 0.05, 0.05), 3.0, 40.0
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


@dataclass(slots=True)
class RefitBudget:
    """Processor time that the refits of all trackers of a process may take; starts are not counted.

    Valves that start together ask for their refits together, which would make the blocks of all of them late.
    A refit that is refused is asked for again with the next chunk. Without a limit, as in a replay, what a
    tracker does depends on its samples alone.

    Attributes:
        share: s of refits in a second.
    """

    share: float = math.inf
    _saved: float = 1.0
    _since: float = field(default_factory=time.monotonic)

    def allows(self) -> bool:
        """Whether a refit may begin now; at most the share of one second is saved up."""
        if math.isinf(self.share):
            return True
        now = time.monotonic()
        self._saved = min(self.share, self._saved + self.share * (now - self._since))
        self._since = now
        return self._saved > 0.0

    def spend(self, seconds: float) -> None:
        """Count a refit that took so many ``seconds``."""
        if not math.isinf(self.share):
            self._saved -= seconds


#: Budget of this process.
BUDGET = RefitBudget()


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Knowledge of a tracker; the fields are those of the tracker, ``offset`` (m/s^2) is the body's."""

    regression: RecursiveLeastSquares | SlidingLeastSquares
    started: bool
    pointwise: bool
    offset: float
    powers: Array
    sizes: Array
    typical: Array
    evidence: Array
    distinguished: bool
    least: float


@dataclass(slots=True)
class Tracker:
    """Tracker of k (N/m), c (N s/m) and F_c (N) of one valve from its samples, chunk by chunk.

    Args:
        sample_period: s.
        mass: kg.
        scale: orders of magnitude of the parameters, shape (3,).
        memory: s, time constant of forgetting, or length of the sliding window.
        sliding: forget by a sliding window.
        low_cut, high_cut: Hz, the band.
        sliding_velocity: m/s, see :class:`~.sliding_window.Conditioning`.
        minimum_excitation: m/s^2, rms body acceleration below which parameters are held.

    Attributes:
        powers: mean squares over the last second or so: error, inertia force (N), body acceleration (m/s^2),
            displacement (m), velocity (m/s); NaN before the first. Displacement and velocity start at zero
            and settle within seconds; they only weigh deviations.
        displacement: the spool's in the body, unknown until its start is estimated.
        refits: how often the model was fitted again to the last samples.
        standing: whether the channels change; of a chunk in which they do not nothing is learned.

    """

    sample_period: float
    mass: float
    scale: Array
    memory: float
    sliding: bool
    low_cut: float
    high_cut: float
    sliding_velocity: float
    minimum_excitation: float
    regression: RecursiveLeastSquares | SlidingLeastSquares = field(init=False)
    prediction: Prediction = field(init=False)
    chunk: int = field(init=False)
    powers: Array = field(init=False)
    displacement: Displacement = field(init=False)
    refits: int = field(default=0, init=False)
    standing: StandingWatch = field(init=False)
    _numbers: Array = field(default_factory=lambda: np.zeros(chunks.NUMBERS), init=False)
    _waiting: Samples = field(init=False)
    _history: History = field(init=False)
    _fitter: Fitter = field(init=False)
    _window: ChunkWindow = field(init=False)
    _earlier: Array = field(init=False)
    _typical: Array = field(init=False)
    _verdicts: Array = field(init=False)
    _scales: Array = field(init=False)
    _nominal: Array = field(init=False)
    _sizes: Array = field(init=False)
    _valve: chunks.Valve = field(init=False)
    _patience: int = field(default=5, init=False)

    def __post_init__(self) -> None:
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes = np.zeros(len(MEAN_SQUARES))
        self.regression = self._fresh()
        self._scales = self.scale[:, np.newaxis] * self.scale
        self._nominal = self.scale * np.array([1.0, 1.0, 0.2])
        self._window = ChunkWindow(self.scale)
        self._typical = np.full(len(LENGTHS), chunks.SIGNIFICANT / chunks.ATYPICAL)
        self._verdicts = np.zeros((len(LENGTHS), 3 + self.scale.size))
        self._numbers[chunks.SETTLING] = True
        self._numbers[chunks.LEAST] = math.inf
        self._numbers[chunks.ALLOWED] = chunks.MOST_REFITS
        self.set_period(self.sample_period)

    @property
    def started(self) -> bool:
        """Whether the parameters are those of a fit."""
        return bool(self._numbers[chunks.STARTED])

    @property
    def excited(self) -> bool:
        """Whether the last chunk was excited."""
        return bool(self._numbers[chunks.EXCITED])

    @property
    def settling(self) -> bool:
        """Whether the motion was settling in the last chunk."""
        return bool(self._numbers[chunks.SETTLING])

    @property
    def filled(self) -> int:
        """Samples that wait for their chunk to be full."""
        return int(self._numbers[chunks.WAITING])

    @property
    def used(self) -> int:
        """Samples of the chunks taken last from which was learned."""
        return int(self._numbers[chunks.USED])

    def set_period(self, sample_period: float) -> None:
        """Go on with samples of another period (s): what was learned is kept."""
        self.sample_period = sample_period
        self.chunk = max(8, round(CHUNK / sample_period))
        self._waiting = np.empty((2, self.chunk), np.float32)
        self.standing = StandingWatch(sample_period)
        self.prediction = Prediction(sample_period, self.mass, self.scale, self.low_cut)
        self.displacement = Displacement(sample_period, self.low_cut, self.chunk, CHUNK)
        self._history = History(round(KEPT / CHUNK) * self.chunk)
        self._fitter = Fitter(
            sample_period,
            self.mass,
            self.scale,
            self.low_cut,
            self.high_cut,
            self.sliding_velocity,
            self.chunk,
        )
        self._earlier = np.zeros((max(LENGTHS), self.prediction.state.size))
        self._valve = chunks.Valve(
            sample_period,
            self.mass,
            min(1.0, CHUNK / self.memory),
            ENOUGH / NOISE,
            self.minimum_excitation**2,
            chunks.RAN_AWAY * self.mass**2,
            self.sliding,
        )

    def knowledge(self) -> Knowledge:
        """Return what is known now, for ``restore``."""
        numbers = self._numbers
        return Knowledge(
            self.regression.copy(), self.started, self.prediction.pointwise, self.prediction.offset,
            self.powers.copy(), self._sizes.copy(), self._typical.copy(),
            numbers[chunks.EVIDENCE_POINTWISE : chunks.EVIDENCE_BAND_LIMITED + 1].copy(),
            bool(numbers[chunks.DISTINGUISHED]), float(numbers[chunks.LEAST]),
        )  # fmt: skip

    def restore(self, known: Knowledge | None) -> None:
        """Go back to what was ``known``, or to nothing, and begin the motion again."""
        if known is None:
            self._forget()
            return
        numbers = self._numbers
        self.regression, numbers[chunks.STARTED] = known.regression.copy(), known.started
        self.powers, self._sizes = known.powers.copy(), known.sizes.copy()
        self._typical = known.typical.copy()
        numbers[chunks.EVIDENCE_POINTWISE : chunks.EVIDENCE_BAND_LIMITED + 1] = known.evidence
        numbers[chunks.DISTINGUISHED], numbers[chunks.LEAST] = known.distinguished, known.least
        self.prediction.reset(known.offset)
        self.prediction.pointwise = known.pointwise
        self.restart()

    def begin(self) -> None:
        """Begin again after a gap: what was learned is kept, the newest samples are not."""
        self.standing.reset()
        self.restart()

    def restart(self) -> None:
        """Begin the motion again: what was learned is kept."""
        pointwise, offset = self.prediction.pointwise, self.prediction.offset
        self.prediction.reset(offset if self.started else math.nan)
        self.prediction.pointwise = pointwise
        self.powers[MEAN_SQUARES.index(BODY)] = math.nan
        self.displacement.reset()
        self._history.clear()
        self._window.clear()
        self._numbers[[chunks.EARLIER, chunks.SINCE_RESTART, chunks.WAITING, chunks.PAUSE]] = 0.0
        self._patience = 5

    def take(self, body: Samples, spool: Samples, most: int = 1) -> tuple[int, int]:
        """Take samples of shape (n,), m/s^2, up to the end of ``most`` chunks, or of one that is not regular.

        Returns:
            How many samples were taken, and how many chunks became full.

        """
        numbers = self._numbers
        filled = self.filled
        if filled + body.size < self.chunk:
            self._waiting[0, filled : filled + body.size] = body
            self._waiting[1, filled : filled + body.size] = spool
            numbers[chunks.WAITING] += body.size
            return body.size, 0
        try:
            self._tell()
            asked = chunks.follow(
                body, spool, most, self._valve, self._arrays, self.standing.arrays, self.displacement.arrays,
                self.prediction.arrays, self._window.arrays, self.regression.arrays,
            )  # fmt: skip
            self._hear()
            self._answer(asked)
        except (np.linalg.LinAlgError, ZeroDivisionError):
            # Channels of no passive valve, exchanged or dead ones, lead to sums that overflow or vanish.
            self._forget()
        return int(numbers[chunks.TAKEN]), int(numbers[chunks.CHUNKS])

    def _answer(self, asked: int) -> None:
        """Do what the kernel asked, until its chunk has ended."""
        while asked != chunks.NOTHING:
            if asked == chunks.STAND:
                self._numbers[[chunks.EXCITED, chunks.SETTLING]] = False, True
                self.restart()
                return
            if asked == chunks.FORGET:
                self._forget()
                return
            ended = True  # nothing else is to be learned from the chunk
            if asked == chunks.SLIDE:
                prediction, ended = self.prediction, False
                score, noise_score = prediction.product - prediction.noise_score, prediction.noise_score
                weight = NOISE**2 / (float(self._verdicts[-1, 1]) + SMALLEST_NOISE**2)
                doubt = chunks.DOUBT * noise_score
                prediction.shift(self.regression.advance(prediction.gram, score, doubt, weight))
            elif asked == chunks.FRESH:
                self._numbers[chunks.STARTED] = False
                self.regression = self._fresh()
            elif asked == chunks.FIRST_START:
                self._start(math.inf)
            elif asked == chunks.POOR_START:
                ended = self._start(0.5 * float(self._verdicts[-1, 0]))
            elif BUDGET.allows():
                begun = time.thread_time()
                ended = self._refit(asked)
                BUDGET.spend(time.thread_time() - begun)
            else:
                ended = False
            if ended:
                chunks.end_chunk(self._arrays, self.prediction.arrays)
                return
            self._tell()
            asked = chunks.regress(
                asked + 1, self._valve, self._arrays, self.prediction.arrays, self._window.arrays,
                self.regression.arrays,
            )  # fmt: skip
            self._hear()

    @property
    def _arrays(self) -> chunks.TrackerArrays:
        return chunks.TrackerArrays(
            self._numbers, self._waiting, self._history.ring, self.powers, self._sizes, self._typical,
            self._earlier, self._verdicts, self.scale, self._nominal,
        )  # fmt: skip

    def _tell(self) -> None:
        """Give the kernel what the parts count."""
        numbers = self._numbers
        numbers[chunks.POINT_VALUES], numbers[chunks.WINDOW] = self.prediction.pointwise, self._window.count
        numbers[chunks.KEPT_SAMPLES] = self._history.taken

    def _hear(self) -> None:
        """Take back from the kernel what the parts count."""
        numbers = self._numbers
        self.prediction.pointwise, self._window.count = (
            bool(numbers[chunks.POINT_VALUES]),
            int(numbers[chunks.WINDOW]),
        )
        self._history.taken = int(numbers[chunks.KEPT_SAMPLES])

    @property
    def systematic(self) -> Array:
        """Standard deviations that no amount of data removes, shape (3,)."""
        shape = POINT_SHAPE if self.prediction.pointwise else JUMP_SHAPE
        if not self._numbers[chunks.DISTINGUISHED]:
            shape = UNTOLD_SHAPE * self.sample_period
        _, target, _, displacement, velocity = (
            math.sqrt(max(power, 1e-20)) for power in self._sizes.tolist()
        )
        force = math.hypot(MATCHED * target, shape * float(self.regression.parameters[2]))
        return np.array([force / displacement, force / velocity, force])

    @property
    def covariance(self) -> Array:
        """Covariance of k, c, F_c, shape (3, 3): of the regression, and what no amount of data removes."""
        bias = self.regression.bias
        chance = (self.regression.covariance + bias[:, np.newaxis] * bias) * self._scales
        chance.reshape(-1)[:: self.scale.size + 1] += self.systematic**2  # the diagonal
        return np.asarray(chance)

    def _fresh(self) -> RecursiveLeastSquares | SlidingLeastSquares:
        if self.sliding:
            return SlidingLeastSquares(self.scale, max(5, round(self.memory / CHUNK)), NOISE)
        return RecursiveLeastSquares(self.scale, min(1.0, CHUNK / self.memory), NOISE)

    def _forget(self) -> None:
        """Begin with nothing known: what was learned does not describe anything."""
        self._numbers[[chunks.STARTED, chunks.EXCITED, chunks.SETTLING]] = False, False, True
        self._numbers[[chunks.EVIDENCE_POINTWISE, chunks.EVIDENCE_BAND_LIMITED]] = 0.0
        self.regression = self._fresh()
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes = np.zeros(len(MEAN_SQUARES))
        self.prediction.pointwise = False
        self.restart()

    def _start(self, present: float) -> bool:
        """Fit to all samples that are kept; believe it where it leaves less than ``present`` (N^2)."""
        self._numbers[chunks.PAUSE] = self._patience
        self._patience = min(self._patience + 1, 100)
        body, spool = self._history.samples(self._history.length)
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
        former, self.regression = self.regression, self._fresh()
        self._begin(found)
        if self.regression.standard_deviations[0] > STARTED * found.parameters[0]:
            self.regression = former
            return False
        self._adopt(found)
        self.prediction = found.prediction
        self._numbers[chunks.STARTED] = True
        self._patience = 5
        return True

    def _refit(self, which: int) -> bool:
        """Fit to the last chunks, weakly held to what was known; believe it where it is clearly better."""
        numbers, last, present = self._numbers, LENGTHS[which], float(self._verdicts[which, 0])
        numbers[chunks.ALLOWED] -= 1.0
        if which == len(LENGTHS) - 1 and numbers[chunks.CHECK] <= 0.0:
            numbers[chunks.BETWEEN] = min(chunks.LAST_CHECK, 2.0 * numbers[chunks.BETWEEN])
            numbers[chunks.CHECK] = numbers[chunks.BETWEEN]
        known = self.regression.parameters
        if numbers[chunks.EARLIER] < last:
            return False
        body, spool = self._history.samples(last * self.chunk)
        begin = self._earlier[int(numbers[chunks.EARLIER] - last) % len(self._earlier)]
        # Dry friction makes local minima: it is tried from both sides.
        guesses = [known, known * np.array([1.0, 1.0, 1.25]), known * np.array([1.0, 1.0, 0.75])]
        best = self._window.best(last)
        if 0.1 < best[0] / known[0] < 10.0 and best[1] > 0.0:
            guesses.append(best)
        width = LARGEST_STEP * np.maximum(np.abs(known) / self.scale, 0.2)
        found = self._fitter.descend(
            body, spool, guesses, last, begin=self.prediction.at(begin), prior=present / width**2
        )
        if found is None or not found.variance < BETTER * present:
            return False
        usual = float(numbers[chunks.USUAL_GAIN])
        information = found.grams.sum(axis=0) / (found.variance * max(COLOURED, usual))
        deviation = np.sqrt(np.abs(np.diag(np.linalg.pinv(information)))) * self.scale
        notable = np.array(NOTABLE) * np.maximum(np.abs(known), 0.1 * self.scale)
        if np.all(np.abs(found.parameters - known) < np.maximum(notable, CERTAIN * deviation)):
            return False
        self._begin(found)
        self._adopt(found)
        self.prediction = found.prediction
        return True

    def _begin(self, found: WindowFit) -> None:
        """Let the regression go on from ``found``."""
        weight = NOISE**2 / (found.variance + SMALLEST_NOISE**2)
        self.regression.begin(
            found.parameters,
            found.grams * weight,
            found.scores * weight,
            chunks.DOUBT * weight * found.noise_score,
        )

    def _adopt(self, found: WindowFit) -> None:
        """Judge the chunks from now on by ``found``."""
        self.powers[0] = found.variance
        self._numbers[[chunks.CHECK, chunks.BETWEEN]] = chunks.FIRST_CHECK
        self._window.clear()
        for gram, score, power, count in zip(
            found.grams, found.scores, found.powers, found.counts, strict=True
        ):
            self._window.add_sums(gram, score, float(power), float(count), found.parameters)
        self.refits += 1
