"""Tracking of parameters: least squares of prediction errors with forgetting, and restarts."""

from __future__ import annotations

import copy
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from spool_stream.kernels.standing import StandingWatch

from spool_estimator.motion.history import Fitter, History, WindowFit, sampled_pointwise
from spool_estimator.motion.prediction import (
    BAND_LIMITED,
    BODY,
    COUNT,
    MEAN_SQUARES,
    POINTWISE,
    RESIDUAL,
    Prediction,
)
from spool_estimator.recursion.recursive import RecursiveLeastSquares
from spool_estimator.recursion.sliding import SlidingLeastSquares
from spool_estimator.recursion.window import ChunkWindow

from .stream_estimator import CHUNK

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

#: N, force noise that the prior is weighed with, and the least that a record is believed to have.
NOISE, SMALLEST_NOISE = 0.05, 1.0e-3
#: s of samples that are kept for starts, and how many of them the first one needs.
KEPT, NEEDED = 3.0, 2.0
#: The valve has changed when the parameters leave CHANGED times the residual power of the best fit to the
#: last chunks (one of these lengths), and when what that fit gains, in residual variances, is SIGNIFICANT and
#: ATYPICAL times what it gained lately: noise shaped by a resonance, or a poor model, gains always.
CHANGED, SIGNIFICANT, ATYPICAL, LENGTHS = 1.25, 300.0, 8.0, (4, 10)
_LENGTHS = np.array(LENGTHS)
#: The past is thrown away only for a parameter that changed by its share here, and by so many deviations;
#: their squares are those for white errors times COLOURED, as a resonance colours them.
NOTABLE, CERTAIN, COLOURED = (0.01, 0.05, 0.05), 3.0, 40.0
#: Share by which a chunk moves a typical value, and how far in one step.
TYPICAL, TYPICAL_STEP = 0.03, 3.0
#: A refit has to leave less than this share of the residual power to be believed.
BETTER = 0.85
#: Relative standard deviation that a change of a parameter is believed to have.
LARGEST_STEP = 0.5
#: Refits saved up at most, and how many more a chunk allows: a model that does not fit must not cost more.
MOST_REFITS, REFITS = 6.0, 0.05
#: Relative residual above which the model does not describe what is seen and a new start is tried, and the
#: residual power, relative to the least seen lately, above which it may be in the wrong local minimum.
POOR, WORSE = 0.25, 16.0
#: Relative residual below which a start needs no other guess.
FITS = 0.1
#: Relative standard deviation of the stiffness that a start must reach.
STARTED = 0.1
#: Time constants 2 m / c of the motion after which a start from rest is forgotten, and its limits, s.
FORGOTTEN, SHORTEST_SETTLING, LONGEST_SETTLING = 8.0, 0.5, 1.5
#: m/s, rms velocity above which the spool moves.
MOVING = 2.0e-3
#: Force that no estimate is better than: share of the inertia force that the pair of sensors and the sampling
#: of the excitation are believed to, and shares of F_c that the shape of a band-limited or point jump leaves.
MATCHED, JUMP_SHAPE, POINT_SHAPE = 1.5e-4, 1.5e-3, 1.0e-4
#: The latter where noise hides which of both the samples are, per second of sample period.
UNTOLD_SHAPE = 15.0

#: Error over the body's force (both squared) beyond which the model's motion ran away: of data that no
#: passive valve makes, a dead channel's, least squares make a model that is driven by its own drag.
RAN_AWAY = 1.0e6

#: Share of the correction for the noise of the body's sensor that counts as uncertainty.
DOUBT = 0.5


@dataclass(frozen=True, slots=True)
class Knowledge:
    """Knowledge of a tracker; the fields are those of the tracker, ``offset`` (m/s^2) is the body's."""

    regression: RecursiveLeastSquares | SlidingLeastSquares
    started: bool
    pointwise: bool
    offset: float
    powers: Array
    sizes: Array
    typical: tuple[float, ...]
    evidence: tuple[float, float]
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
        sliding_velocity: m/s, see :class:`~.conditioning.Conditioning`.
        minimum_excitation: m/s^2, rms body acceleration below which parameters are held.

    Attributes:
        started: whether the parameters are those of a fit.
        excited, settling: of the last chunk.
        powers: mean squares over the last second or so: error, inertia force (N), body acceleration (m/s^2),
            displacement (m), velocity (m/s); NaN before the first.
        refits: how often the model was fitted anew to the last samples.
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
    started: bool = field(default=False, init=False)
    excited: bool = field(default=False, init=False)
    settling: bool = field(default=True, init=False)
    powers: Array = field(init=False)
    refits: int = field(default=0, init=False)
    filled: int = field(default=0, init=False)
    standing: StandingWatch = field(init=False)
    _waiting: NDArray[np.float32] = field(init=False)
    _history: History = field(init=False)
    _fitter: Fitter = field(init=False)
    _window: ChunkWindow = field(init=False)
    _earlier: deque[Array] = field(init=False)
    _typical: list[float] = field(init=False)
    _scales: Array = field(init=False)
    _sizes: Array = field(init=False)
    _evidence: tuple[float, float] = field(default=(0.0, 0.0), init=False)
    _distinguished: bool = field(default=False, init=False)
    _least: float = field(default=math.inf, init=False)
    _since_restart: int = field(default=0, init=False)
    _allowed: float = field(default=MOST_REFITS, init=False)
    _pause: int = field(default=0, init=False)
    _patience: int = field(default=5, init=False)

    def __post_init__(self) -> None:
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes = np.zeros(len(MEAN_SQUARES))
        self.regression = self._fresh()
        self._scales = self.scale[:, np.newaxis] * self.scale
        self._window = ChunkWindow(self.scale)
        self._earlier = deque(maxlen=max(LENGTHS))
        self._typical = [SIGNIFICANT / ATYPICAL] * len(LENGTHS)
        self.set_period(self.sample_period)

    def set_period(self, sample_period: float) -> None:
        """Go on with samples of another period (s): what was learned is kept."""
        self.sample_period = sample_period
        self.chunk = max(8, round(CHUNK / sample_period))
        self._waiting = np.empty((2, self.chunk), np.float32)
        self.standing = StandingWatch(sample_period)
        self.prediction = Prediction(sample_period, self.mass, self.scale, self.low_cut)
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

    def knowledge(self) -> Knowledge:
        """Return what is known now, for ``restore``."""
        return Knowledge(
            copy.deepcopy(self.regression), self.started, self.prediction.pointwise, self.prediction.offset,
            self.powers.copy(), self._sizes.copy(), tuple(self._typical), self._evidence, self._distinguished,
            self._least,
        )  # fmt: skip

    def restore(self, known: Knowledge | None) -> None:
        """Go back to what was ``known``, or to nothing, and begin the motion anew."""
        if known is None:
            self._forget()
            return
        self.regression, self.started = copy.deepcopy(known.regression), known.started
        self.powers, self._sizes = known.powers.copy(), known.sizes.copy()
        self._typical, self._evidence = list(known.typical), known.evidence
        self._distinguished, self._least = known.distinguished, known.least
        self.prediction.reset(known.offset)
        self.prediction.pointwise = known.pointwise
        self.restart()

    def begin(self) -> None:
        """Begin anew after a gap: what was learned is kept, the newest samples are not."""
        self.standing.reset()
        self.restart()

    def restart(self) -> None:
        """Begin the motion anew: what was learned is kept."""
        pointwise, offset = self.prediction.pointwise, self.prediction.offset
        self.prediction.reset(offset if self.started else math.nan)
        self.prediction.pointwise = pointwise
        self._history.clear()
        self._window.clear()
        self._earlier.clear()
        self._since_restart = self.filled = self._pause = 0
        self._patience = 5

    def take(self, body: Samples, spool: Samples) -> bool:
        """Take samples of shape (n,), m/s^2, at most what the chunk lacks; return whether it is full."""
        place = slice(self.filled, self.filled + body.size)
        self._waiting[0, place] = body
        self._waiting[1, place] = spool
        self.filled += body.size
        if self.filled < self.chunk:
            return False
        body, spool = self._waiting
        self.filled = 0
        self.standing.take(self._waiting)
        if self.standing.stands:
            self.excited, self.settling = False, True
            self.restart()
            return True
        self._history.take(body, spool)
        self.prediction.take(body, spool, self.regression.parameters if self.started else self._nominal)
        try:
            self._close()
        except np.linalg.LinAlgError:
            # Channels of no passive valve, exchanged or dead ones, lead to sums that overflow.
            self._forget()
        return True

    @property
    def systematic(self) -> Array:
        """Standard deviations that no amount of data removes, shape (3,)."""
        shape = POINT_SHAPE if self.prediction.pointwise else JUMP_SHAPE
        if not self._distinguished:
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
        return np.asarray(chance + np.diag(self.systematic**2))

    @property
    def _nominal(self) -> Array:
        return np.asarray(self.scale * np.array([1.0, 1.0, 0.2]))

    def _fresh(self) -> RecursiveLeastSquares | SlidingLeastSquares:
        if self.sliding:
            return SlidingLeastSquares(self.scale, max(5, round(self.memory / CHUNK)), NOISE)
        return RecursiveLeastSquares(self.scale, min(1.0, CHUNK / self.memory), NOISE)

    def _forget(self) -> None:
        """Begin with nothing known: what was learned does not describe anything."""
        self.started, self.excited, self.settling = False, False, True
        self.regression = self._fresh()
        self.powers = np.full(len(MEAN_SQUARES), math.nan)
        self._sizes, self._evidence = np.zeros(len(MEAN_SQUARES)), (0.0, 0.0)
        self.prediction.pointwise = False
        self.restart()

    def _settling_chunks(self) -> int:
        viscous = max(float(self.regression.parameters[1] if self.started else self.scale[1]), 1e-9)
        time = min(LONGEST_SETTLING, max(SHORTEST_SETTLING, FORGOTTEN * 2.0 * self.mass / viscous))
        return math.ceil(time / CHUNK)

    def _close(self) -> None:
        sums = self.prediction.sums.tolist()
        if self.started and not sums[RESIDUAL] <= RAN_AWAY * self.mass**2 * max(
            sums[BODY], sums[COUNT] * self.minimum_excitation**2
        ):
            self._forget()
            return
        self._since_restart += 1
        powers = self.prediction.mean_squares
        _, _, body, _, velocity = powers.tolist()
        self.settling = self._since_restart <= self._settling_chunks()
        self._allowed = min(MOST_REFITS, self._allowed + REFITS)
        self._pause -= 1
        moves = body > self.minimum_excitation**2 and velocity > MOVING**2
        self.excited = moves and not self.settling
        if not self.settling:
            known = math.isfinite(self.powers[0])
            self.powers = self.powers + CHUNK / 1.0 * (powers - self.powers) if known else powers.copy()
        if self.excited:
            # Of the motion that taught the parameters; at a standstill they stay what they were.
            self._sizes = self.powers
            # Weighed by how well the model fits: while the valve changes, neither does.
            left = max(sums[RESIDUAL], 1e-30)
            pointwise, band_limited = self._evidence
            self._evidence = (
                pointwise + TYPICAL * (sums[POINTWISE] / left - pointwise),
                band_limited + TYPICAL * (sums[BAND_LIMITED] / left - band_limited),
            )
        if self.excited and self.started:
            self._regress(sums[RESIDUAL], max(1.0, sums[COUNT]))
        elif self.excited and self._since_restart * CHUNK >= NEEDED - 1e-9:
            self._start(math.inf)
        self.prediction.clear()
        self._earlier.append(self.prediction.state.copy())

    def _regress(self, residual: float, count: float) -> None:
        prediction, regression = self.prediction, self.regression
        noise_score = prediction.noise_score
        score = prediction.product - noise_score
        verdicts = self._window.take(prediction.gram, score, residual, count, regression.parameters, _LENGTHS)
        present = own = math.inf
        for which, last in enumerate(LENGTHS):
            present, own, samples = verdicts[which]
            if self._window.count < last:
                continue
            gain = (present / own - 1.0) * samples
            typical = self._typical[which]
            self._typical[which] += TYPICAL * (min(gain, TYPICAL_STEP * typical) - typical)
            changed = present > CHANGED * own and gain > max(SIGNIFICANT, ATYPICAL * typical)
            if changed and self._refit(last, present, typical):
                return
        # A descent may have ended in the wrong local minimum: far more is left than was once.
        target = float(self.powers[1])
        self._least = min(1.01 * self._least, own / target)
        poor = own > POOR**2 * target or own > WORSE * self._least * target
        if poor and self._since_restart * CHUNK >= NEEDED and self._start(0.5 * present):
            return
        weight = NOISE**2 / (own + SMALLEST_NOISE**2)
        change = regression.advance(prediction.gram, score, DOUBT * noise_score, weight)
        prediction.shift(change)
        pointwise, band_limited = self._evidence
        prediction.pointwise = sampled_pointwise(pointwise, band_limited, present=prediction.pointwise)
        surely = sampled_pointwise(pointwise, band_limited, present=True)
        self._distinguished = self._distinguished or surely == sampled_pointwise(
            pointwise, band_limited, present=False
        )
        found = regression.parameters.tolist()
        if not (all(map(math.isfinite, found)) and found[0] > 0.0):
            self.started = False
            self.regression = self._fresh()

    def _start(self, present: float) -> bool:
        """Fit to all samples that are kept; believe it where it leaves less than ``present`` (N^2)."""
        if self._pause > 0:
            return False
        self._pause = self._patience
        self._patience = min(self._patience + 1, 100)
        body, spool = self._history.samples(self._history.length)
        first = self._fitter.start(body, spool)
        guesses = [self._nominal] if first is None or first[0] <= 0.0 else [first, self._nominal]
        if self.started:
            guesses.append(self.regression.parameters)
        last = body.size // self.chunk - self._settling_chunks()
        offset = float(np.average(body, weights=np.hanning(body.size + 2)[1:-1]))
        found = self._fitter.descend(
            body, spool, guesses, last, begin=self._fitter.at_rest(offset), enough=FITS**2
        )
        if found is None or not found.variance < BETTER * present:
            return False
        former = self.regression
        self.regression = self._fresh()
        self._adopt(found)
        if self.regression.standard_deviations[0] > STARTED * found.parameters[0]:
            self.regression = former
            return False
        self.prediction = found.prediction
        self.started = True
        self._patience = 5
        return True

    def _refit(self, last: int, present: float, typical: float) -> bool:
        """Fit to the last chunks, weakly held to what was known; believe it where it is clearly better."""
        if self._allowed < 1.0:
            return False
        self._allowed -= 1.0
        known = self.regression.parameters
        if len(self._earlier) < last:
            return False
        body, spool = self._history.samples(last * self.chunk)
        # Dry friction makes local minima: it is tried from both sides.
        guesses = [known, known * np.array([1.0, 1.0, 1.25]), known * np.array([1.0, 1.0, 0.75])]
        best = self._window.best(last)
        if 0.1 < best[0] / known[0] < 10.0 and best[1] > 0.0:
            guesses.append(best)
        width = LARGEST_STEP * np.maximum(np.abs(known) / self.scale, 0.2)
        found = self._fitter.descend(
            body,
            spool,
            guesses,
            last,
            begin=self.prediction.at(self._earlier[-last]),
            prior=present / width**2,
        )
        if found is None or not found.variance < BETTER * present:
            return False
        information = found.grams.sum(axis=0) / (found.variance * max(COLOURED, typical))
        deviation = np.sqrt(np.abs(np.diag(np.linalg.pinv(information)))) * self.scale
        notable = np.array(NOTABLE) * np.maximum(np.abs(known), 0.1 * self.scale)
        if np.all(np.abs(found.parameters - known) < np.maximum(notable, CERTAIN * deviation)):
            return False
        self._adopt(found)
        self.prediction = found.prediction
        return True

    def _adopt(self, found: WindowFit) -> None:
        weight = NOISE**2 / (found.variance + SMALLEST_NOISE**2)
        self.regression.begin(
            found.parameters, found.grams * weight, found.scores * weight, DOUBT * weight * found.noise_score
        )
        self.powers[0] = found.variance
        self._window.clear()
        for gram, score, power, count in zip(
            found.grams, found.scores, found.powers, found.counts, strict=True
        ):
            self._window.add_sums(gram, score, float(power), float(count), found.parameters)
        self.refits += 1
