"""Channel pair: what both accelerometers show about their sensitivities, clocks and coupling.

Below its resonance a spool follows its body, so gain, delay and corner of one channel against the other show
there without a description of the valve. They are fitted together with the equation of motion per mass,

    s + w0^2 z + d v + f tanh(v / v0) = 0,   z'' = s - b,

to the band from ``LOW`` to ``HIGH``. The reading of the spool is corrected before: divided by its gain, taken
earlier by its delay, and freed of a high-pass of first order; a negative corner is the body's. Dry friction
enters by its own term, so it bends none of the three. What no such valve explains is not judged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy import fft
from numpy.typing import NDArray
from spool_core.numbers import Array, Complex
from spool_core.uncertainty import Z_95

from spool_estimator.identification.pair_accounts import (
    FINE,
    SMOOTH,
    best_delay,
    best_step,
    glance,
    leaves,
    piece_sums,
    remainder,
)
from spool_estimator.identification.spectra import ZeroPhase, faded, fast_length, frequencies

#: Hz: full gain from twice the lower edge on; directional valves resonate at 10 to 60 Hz, and what their
#: springs decide ends within an octave or two above.
LOW, HIGH = 4.0, 150.0
#: s at each end that the taper takes, and that the filter's edge needs on top.
TAPER = 0.25
#: Gains that are tried first, and beyond which no gain is believed.
GAINS: Array = np.exp(np.linspace(-math.log(16.0), math.log(16.0), 23))
LARGEST_GAIN = 32.0
#: Scales of the steps in the logarithm of the gain, the delay (s) and the corner (rad/s).
SCALES: Array = np.array([0.1, 1e-3, 1.0])
#: Rounds of the descent, and relative change of the squares that ends it.
ROUNDS, ENDS = 12, 1e-4
#: Residual samples that are independent, over the lines of the band; a resonance colours the residual.
COLOURED = 4.0
#: s around no delay in which steps of one clock are tried, and of a piece of the record.
NEAREST, BIN = 12e-3, 0.5
#: A larger step is looked for where a valve fitted to the first pieces leaves at least this share of the
#: power in the later ones, and this many times its share in the first ones.
UNEXPLAINED, CHANGED = 0.2, 4.0
#: s, the largest step that is looked for; how many of the best matches are tried, as each turn of a machine
#: matches nearly as well.
FARTHEST, PEAKS = 2.0, 5
#: s on both sides of a step that the filter mixes.
MIXED = 0.5
#: s, length of the segments whose phases show how one clock runs against the other, and time between two of
#: them; the largest rate that is looked for; s by which a delay known from nearer segments may be wrong.
SEGMENT, HOP, LARGEST_RATE, AROUND = 2.0, 0.5, 0.02, 8e-3
#: Relative half width of a second's natural frequency (95 %) beyond which that second is left out.
UNSURE = 0.2

GAIN, DELAY, CORNER = range(3)
#: Rows of the spool: its slope, itself, and integrated once, twice, three times; of the body, integrated.
SLOPE, SAME, ONCE, TWICE, THRICE = range(5)


@dataclass(frozen=True, slots=True)
class PairFit:
    """Spool's channel against the body's: gain over it, delay (s) and corner (Hz).

    ``deviations`` are of the gain's logarithm, the delay (s) and the corner (Hz), NaN where held.
    ``residual`` is what the fit leaves over the spool's acceleration, rms. ``stiffness`` (1/s^2), ``damping``
    (1/s) and ``friction`` (m/s^2) are the valve's per mass.
    """

    gain: float
    delay: float
    corner: float
    deviations: tuple[float, float, float]
    residual: float
    stiffness: float
    damping: float
    friction: float

    @property
    def natural_frequency(self) -> float:
        """Hz, 0 where the fit has no spring."""
        return math.sqrt(max(0.0, self.stiffness)) / (2.0 * math.pi)


class Glance(NamedTuple):
    """Squares that several accounts of a pair leave, over those of the spool's acceleration.

    ``plain``: both channels are as they should be. ``constant``: gain, corner and a small delay or drift are
    whatever fits best. ``parted``: they, and the valve, are others before and behind the best moment; a short
    record has none. ``delay`` (s) is what fits best beside the gain, and leaves ``delayed``.
    """

    plain: float
    constant: float
    parted: float
    delay: float
    delayed: float


@dataclass(frozen=True, slots=True)
class Swing:
    """How the spool swings for a moment: natural frequency (Hz) and damping ratio, with their deviations."""

    frequency: float
    frequency_deviation: float
    ratio: float
    ratio_deviation: float


@dataclass(frozen=True, slots=True)
class ClockStep:
    """Step of one clock against the other: at ``time`` (s) the spool's delay changes by ``size`` (s).

    ``common``, ``clock`` and ``valve`` are the residuals of three accounts of the record: nothing changes,
    one clock steps, the valve changes.
    """

    time: float
    size: float
    common: float
    clock: float
    valve: float


@dataclass(slots=True)
class ChannelPair:
    """Readings of body and spool (m/s^2, shape (n,)), ``period`` s apart, in one band."""

    body: Array
    spool: Array
    period: float
    _turn: Complex = field(init=False)
    _b: Complex = field(init=False)
    _s: Complex = field(init=False)
    _size: int = field(init=False)
    _period: float = field(init=False)
    _edge: int = field(init=False)
    _band: Array = field(init=False)
    _of_body: Array = field(init=False)
    _of_spool: tuple[float, Array] = field(init=False)

    def __post_init__(self) -> None:
        size = self.body.size
        high = min(HIGH, 0.32 / self.period)
        frequency = frequencies(size, self.period)
        wanted = min(frequency.size - 1, math.ceil(1.25 * high * size * self.period))
        lines = min(frequency.size - 1, fast_length(2 * wanted) // 2)
        self._size = 2 * lines
        self._period = self.period * size / self._size
        self._edge = round((TAPER + 1.0 / LOW) / self._period)
        self._turn = np.asarray(2j * np.pi * frequency[: lines + 1], np.complex128)
        self._turn[0] = 1.0
        self._band = ZeroPhase(self.period, LOW, high).gain(frequency[: lines + 1])
        scale = self._band * self._size / size
        scale[0] = 0.0
        taper = faded(size, min(round(TAPER / self.period), size // 2))
        self._b, self._s = (
            fft.rfft((row - row.mean()) * taper)[: lines + 1] * scale for row in (self.body, self.spool)
        )
        powers = self._turn ** -np.arange(1.0, 4.0)[:, np.newaxis]
        self._of_body = self._inside(fft.irfft(self._b * powers, self._size))
        self._of_spool = (math.nan, self._of_body)

    @property
    def long_enough(self) -> bool:
        """Whether there is more than what the edges take."""
        return self._size > 4 * self._edge

    @property
    def spread(self) -> float:
        """Standard deviation of the logarithm of the body's frequencies, weighed by their power."""
        power = np.abs(self._b[1:]) ** 2
        weight = power / max(float(power.sum()), 1e-300)
        octaves = np.log(np.abs(self._turn[1:]))
        return math.sqrt(max(0.0, float(weight @ octaves**2 - (weight @ octaves) ** 2)))

    def below(self, frequency: float) -> float:
        """Return the share of the body's power below ``frequency`` (Hz)."""
        power = np.abs(self._b) ** 2
        return float(power[np.abs(self._turn) < 2.0 * np.pi * frequency].sum() / max(power.sum(), 1e-300))

    def glance(self) -> Glance:
        """Return what accounts of the pair can leave at least, where delays and drifts are small."""
        spool = self._spool(0.0)
        rows = np.concatenate([spool[[SAME, SLOPE]], spool[ONCE:], self._of_body, np.empty_like(spool[:1])])
        bins = min(max(1, round(BIN / self._period)), rows.shape[1])
        return Glance(*glance(rows, bins, math.ceil(2.0 * MIXED / BIN), round(MIXED / BIN)))

    def fit(self, free: tuple[int, ...] = (GAIN, DELAY, CORNER), start: PairFit | None = None) -> PairFit:
        """Return the fit with the quantities ``free``, the others held at their ``start``, or at nothing."""
        point: Array = np.zeros(3)
        if start is not None:
            point = np.array([math.log(start.gain), start.delay, 2.0 * math.pi * start.corner])
        elif GAIN in free:
            squares = [self._left(np.array([math.log(gain), 0.0, 0.0]))[0] for gain in GAINS]
            point[GAIN] = math.log(GAINS[int(np.argmin(squares))])
        squares_now, valve, left = self._left(point)
        damped, chosen = 1e-3, list(free)
        for _ in range(ROUNDS if free else 0):
            slopes = self._slopes(point, left, free)
            normal, downhill = slopes @ slopes.T, -slopes @ left
            for _ in range(6):
                step = np.zeros(3)
                step[chosen] = np.linalg.solve(normal + damped * np.diag(np.diag(normal) + 1e-12), downhill)
                trial = point + step * SCALES
                trial[GAIN] = np.clip(trial[GAIN], -math.log(LARGEST_GAIN), math.log(LARGEST_GAIN))
                new_squares, new_valve, new_left = self._left(trial)
                if new_squares < squares_now:
                    break
                damped *= 5.0
            else:
                break
            settled = squares_now - new_squares < ENDS * squares_now
            point, left, valve, squares_now = trial, new_left, new_valve, new_squares
            damped = max(0.1 * damped, 1e-6)
            if settled:
                break
        deviations: Array = np.full(3, math.nan)
        if free:
            slopes = self._slopes(point, left, free)
            independent = min(left.size, 2 * np.count_nonzero(np.abs(self._b) > 0.0)) / COLOURED
            covariance = np.linalg.pinv(slopes @ slopes.T) * left.size * squares_now / max(independent, 1.0)
            deviations[chosen] = np.sqrt(np.diag(covariance)) * SCALES[chosen]
        deviations[CORNER] /= 2.0 * math.pi
        return PairFit(
            math.exp(point[GAIN]),
            float(point[DELAY]),
            float(point[CORNER]) / (2.0 * math.pi),
            (float(deviations[0]), float(deviations[1]), float(deviations[2])),
            math.sqrt(squares_now),
            *valve,
        )

    def swings(self, most: int, leaves: float) -> list[Swing]:
        """Return how the spool swings in each of the first ``most`` seconds, by linear regression.

        The module's equation is solved for spring, viscous and dry friction, with gain 1 and no delay. Left
        out are seconds of which it leaves more than the share ``leaves`` (rms), and those whose frequency has
        a relative half width (95 %) above ``UNSURE``.
        """
        # The velocity's sign in the band: its harmonics neither alias nor pass.
        velocity = fft.irfft((self._s - self._b) / self._turn, FINE * self._size)
        sign = np.tanh(velocity / (SMOOTH * float(np.std(velocity)) + 1e-300))
        harmonics = fft.rfft(sign)[: self._turn.size] * self._band / FINE
        sign = self._inside(fft.irfft(harmonics, self._size))
        spool = self._spool(0.0)
        rows = np.stack([spool[SAME], *(spool[[TWICE, ONCE]] - self._of_body[[1, 0]]), sign])
        bins = max(1, round(1.0 / self._period))
        count = min(most, rows.shape[1] // bins)
        lines = np.count_nonzero(np.abs(self._b) > 0.0) * bins / self._size
        independent = max(1.0, 2.0 * lines / COLOURED - 3.0)
        found = []
        for cut in np.split(rows[:, : count * bins], count, axis=1) if count else ():
            sums = cut @ cut.T
            scale = np.sqrt(np.diagonal(sums)) + 1e-300
            sums /= np.outer(scale, scale)
            inverse = np.linalg.inv(sums[1:, 1:] + 1e-9 * np.eye(3))
            left = max(0.0, 1.0 - float(sums[0, 1:] @ inverse @ sums[0, 1:]))
            stiffness, damping = (-inverse @ sums[1:, 0] * scale[0] / scale[1:])[:2]
            if left > leaves**2 or stiffness <= 0.0:
                continue
            spread = np.sqrt(np.diagonal(inverse) * left / independent) * scale[0] / scale[1:]
            angular = math.sqrt(stiffness)
            natural, share = angular / (2.0 * math.pi), float(0.5 * spread[0] / stiffness)
            if Z_95 * share <= UNSURE:
                halved = 0.5 / angular
                found.append(
                    Swing(natural, share * natural, halved * float(damping), halved * float(spread[1]))
                )
        return found

    def rate(self) -> float:
        """Return how much faster the spool's delay grows than time does, 0 where the pair is too short.

        The valve turns the phase between both channels at each frequency alike in all segments, a clock that
        runs faster turns it in proportion to frequency and time: no valve needs to be known. Segments further
        and further apart tell the rate ever more closely. A sweep that passes each frequency once tells too
        low a rate.
        """
        body, spool = (self._inside(fft.irfft(row, self._size)) for row in (self._b, self._s))
        size, hop = round(SEGMENT / self._period), round(HOP / self._period)
        count = (body.size - size) // hop + 1
        if count < 4:
            return 0.0
        places = np.arange(size) + hop * np.arange(count)[:, np.newaxis]
        frequency = frequencies(size, self._period)
        inside = (frequency > LOW) & (frequency < HIGH)
        one, other = (fft.rfft(row[places] * np.hanning(size), axis=1)[:, inside] for row in (body, spool))
        cross = other * np.conj(one)
        # Loud lines weigh more, but not with the fourth power of their amplitude.
        cross /= np.sqrt(np.abs(cross) + 1e-3 * np.abs(cross).max() + 1e-300)
        apart, rate, reach = 1, 0.0, LARGEST_RATE * HOP
        while apart <= count // 2:
            seconds = hop * self._period * apart
            turned = np.sum(cross[apart:] * np.conj(cross[:-apart]), axis=0)
            rate += best_delay(turned, frequency[inside], rate * seconds, reach) / seconds
            reach = min(reach, AROUND)
            apart *= 2
        return rate

    def step(self, known: PairFit) -> ClockStep | None:
        """Return the best account of the record by a step of one clock; ``None`` where it is too short.

        Args:
            known: gain that the pair has throughout.

        """
        bins = max(1, round(BIN / self._period))
        count = (self._size - 2 * self._edge) // bins
        margin = math.ceil(2.0 * MIXED / BIN)
        if count < 4 * margin:
            return None
        powers = self._turn ** -np.arange(3.0)[:, np.newaxis]
        fine = FINE * fft.irfft(self._s * powers, FINE * self._size)
        near = round(NEAREST * FINE / self._period)
        delays = np.arange(-near, near + 1)
        sums = piece_sums(fine, self._of_body, delays, math.log(known.gain), bins, count)
        if not sums[near, :, 0, 0].sum() > 0.0:
            return None
        far = self._far(known, sums[near], bins, margin)
        if far is not None:
            delays = np.concatenate([delays, far])
            later = piece_sums(fine, self._of_body, far, math.log(known.gain), bins, count)
            sums = np.concatenate([sums, later])
        totals = np.concatenate([np.zeros((delays.size, 1, 4, 4)), np.cumsum(sums, axis=1)], axis=1)
        split, first, second, *left = best_step(totals, margin, round(MIXED / BIN), near)
        return ClockStep(
            (self._edge + split * bins) * self._period,
            float(delays[second] - delays[first]) * self._period / FINE,
            *left,
        )

    def _far(self, known: PairFit, sums: Array, bins: int, margin: int) -> NDArray[np.int64] | None:
        """Return delays that the later pieces may have, where the valve of the first ones fails for them.

        They are in fine samples. ``sums`` are the normal equations of the pieces without a delay, shape
        (pieces, 4, 4). The motion that this valve predicts from the body's is correlated with the reading;
        its best matches are the delays. ``None`` where the valve of the first pieces explains the later ones.
        """
        totals = np.cumsum(sums, axis=0)
        # Over the mean power of a piece, so that the first valve has its largest error behind the step.
        piece = float(totals[-1, 0, 0]) / sums.shape[0]
        accounts = []
        for split in range(margin, sums.shape[0] - margin + 1):
            left, values = remainder(totals[split - 1])
            account, after = np.array([1.0, *-values]), totals[-1] - totals[split - 1]
            later = float(account @ after @ account) / (piece * (sums.shape[0] - split))
            accounts.append((later, left / (piece * split), split, account))
        later, earlier, place, valve = max(accounts, key=lambda one: one[0] - one[1])
        if later < max(UNEXPLAINED, CHANGED * earlier):
            return None
        law = valve[1] + valve[2] * self._turn
        reading = fft.irfft(self._s / known.gain, self._size)
        reading[: self._edge + place * bins] = 0.0
        reading[self._size - self._edge :] = 0.0
        moved = self._b * law / (law + self._turn**2)
        match = fft.irfft(fft.rfft(reading) * np.conj(moved), self._size)
        lags = np.arange(-round(FARTHEST / self._period), round(FARTHEST / self._period) + 1)
        height = match[lags % self._size]
        peaks = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:]))
        best = lags[peaks[np.argsort(-height[peaks])[:PEAKS]]]
        around = np.arange(-FINE, FINE + 1, FINE // 4)
        return np.asarray(np.unique(np.add.outer(FINE * best, around)), np.int64)

    def _inside(self, rows: Array) -> Array:
        """Return ``rows``, shape (..., size), without what the edges take."""
        return np.ascontiguousarray(rows[..., self._edge : self._size - self._edge])

    def _spool(self, delay: float) -> Array:
        """Return the spool taken earlier by ``delay`` (s): its rows as above, shape (5, m)."""
        if self._of_spool[0] != delay:
            powers = self._turn ** np.arange(1.0, -4.0, -1.0)[:, np.newaxis]
            rows = fft.irfft(self._s * np.exp(self._turn * delay) * powers, self._size)
            self._of_spool = (delay, self._inside(rows))
        return self._of_spool[1]

    def _left(self, point: Array, slip: float = 0.0) -> tuple[float, tuple[float, float, float], Array]:
        """Return what the best valve leaves over the spool's rms: mean square, its numbers, and samples.

        ``slip`` (s) is added to the delay of ``point`` to first order.
        """
        left = np.empty(self._of_body.shape[1])
        square, *valve = leaves(
            self._spool(point[DELAY]), self._of_body, point[GAIN], point[CORNER], slip, left
        )
        return square, (valve[0], valve[1], valve[2]), left

    def _slopes(self, point: Array, left: Array, free: tuple[int, ...]) -> Array:
        """Return the slopes of the residual over ``free``, in units of their scales, shape (len(free), m)."""
        slopes = np.empty((len(free), left.size))
        for place, which in enumerate(free):
            moved, small = point.copy(), 0.01 * SCALES[which]
            if which != DELAY:
                moved[which] += small
            slopes[place] = (self._left(moved, small if which == DELAY else 0.0)[2] - left) / 0.01
        return slopes
