"""Channel pair: what both accelerometers show of their own sensitivities, clocks and coupling.

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

import numpy as np
from numpy import fft
from spool_core.numbers import Array, Complex
from spool_core.uncertainty import Z_95

from spool_estimator.identification.spectra import ZeroPhase, faded, fast_length, frequencies

#: Hz: full gain from twice the lower edge on; directional valves resonate at 10 to 60 Hz, and what their
#: springs decide ends within an octave or two above.
LOW, HIGH = 4.0, 150.0
#: s at each end that the taper takes, and that the filter's edge needs on top.
TAPER = 0.25
#: Speed over its rms below which dry friction is taken as proportional to it.
SMOOTH = 0.05
#: Gains that are tried first, and beyond which no gain is believed.
GAINS: Array = np.exp(np.linspace(-math.log(16.0), math.log(16.0), 23))
LARGEST_GAIN = 32.0
#: Scales of the steps in the logarithm of the gain, the delay (s) and the corner (rad/s).
SCALES: Array = np.array([0.1, 1e-3, 1.0])
#: Rounds of the descent, and relative change of the squares that ends it.
ROUNDS, ENDS = 12, 1e-4
#: Residual samples that are independent, over the lines of the band; a resonance colours what is left.
COLOURED = 4.0
#: Delays that are tried for a step of one clock, s, around the common one, and s of a piece of the record.
STEPS: Array = np.linspace(-12e-3, 12e-3, 49, dtype=np.float64)
BIN = 0.5
#: A step larger than these is looked for where a valve fitted to the first pieces leaves at least this share
#: of the power in the later ones, and this many times its share in the first ones.
UNEXPLAINED, CHANGED = 0.2, 4.0
#: s, the largest step that is looked for; how many of the best matches are tried, as each turn of a machine
#: matches nearly as well; samples around each of them.
FARTHEST, PEAKS = 2.0, 5
NEAR: Array = np.linspace(-1.0, 1.0, 5, dtype=np.float64)
#: s on both sides of a step that the filter mixes.
MIXED = 0.5
#: Times as finely as the pair is sampled that the sign of its velocity is taken.
FINE = 8
#: s, length of the segments whose phases show how one clock runs against the other, and time between two of
#: them; the largest rate that is looked for; s by which a delay known from nearer segments may be wrong.
SEGMENT, HOP, LARGEST_RATE, AROUND = 2.0, 0.5, 0.02, 8e-3
#: Relative half width of a second's natural frequency (95 %) beyond which that second is left out.
UNSURE = 0.2

GAIN, DELAY, CORNER = range(3)


@dataclass(frozen=True, slots=True)
class PairFit:
    """Fit of a pair: gain of the spool's channel over the body's, its delay (s) and corner (Hz).

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


@dataclass(frozen=True, slots=True)
class Swing:
    """Swing of the spool for a moment: natural frequency (Hz) and damping ratio, with their deviations."""

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

    @property
    def long_enough(self) -> bool:
        """Whether there is more than what the edges take."""
        return self._size > 4 * self._edge

    def below(self, frequency: float) -> float:
        """Return the share of the body's power below ``frequency`` (Hz)."""
        power = np.abs(self._b) ** 2
        return float(power[np.abs(self._turn) < 2.0 * np.pi * frequency].sum() / max(power.sum(), 1e-300))

    @property
    def spread(self) -> float:
        """Standard deviation of the logarithm of the body's frequencies, weighed by their power."""
        power = np.abs(self._b[1:]) ** 2
        weight = power / max(float(power.sum()), 1e-300)
        octaves = np.log(np.abs(self._turn[1:]))
        return math.sqrt(max(0.0, float(weight @ octaves**2 - (weight @ octaves) ** 2)))

    def fit(self, free: tuple[int, ...] = (GAIN, DELAY, CORNER), start: PairFit | None = None) -> PairFit:
        """Return the fit with the quantities ``free``, the others held at their ``start``, or at nothing."""
        point: Array = np.zeros(3)
        if start is not None:
            point = np.array([math.log(start.gain), start.delay, 2.0 * math.pi * start.corner])
        elif GAIN in free:
            squares = [
                float(np.mean(self._left(np.array([math.log(gain), 0.0, 0.0]))[0] ** 2)) for gain in GAINS
            ]
            point[GAIN] = math.log(GAINS[int(np.argmin(squares))])
        left, valve = self._left(point)
        squares_now, damped = float(np.mean(left**2)), 1e-3
        chosen = list(free)
        for _ in range(ROUNDS if free else 0):
            slopes = self._slopes(point, left, free)
            normal, downhill = slopes.T @ slopes, -slopes.T @ left
            for _ in range(6):
                step = np.zeros(3)
                step[chosen] = np.linalg.solve(normal + damped * np.diag(np.diag(normal) + 1e-12), downhill)
                trial = point + step * SCALES
                trial[GAIN] = np.clip(trial[GAIN], -math.log(LARGEST_GAIN), math.log(LARGEST_GAIN))
                new_left, new_valve = self._left(trial)
                new_squares = float(np.mean(new_left**2))
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
            covariance = np.linalg.pinv(slopes.T @ slopes) * left.size * squares_now / max(independent, 1.0)
            deviations[chosen] = np.sqrt(np.diag(covariance)) * SCALES[chosen]
        deviations[CORNER] /= 2.0 * math.pi
        return PairFit(
            math.exp(point[GAIN]),
            float(point[DELAY]),
            float(point[CORNER]) / (2.0 * math.pi),
            (float(deviations[0]), float(deviations[1]), float(deviations[2])),
            math.sqrt(squares_now),
            *(float(one) for one in valve),
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
        sign = fft.irfft(harmonics, self._size)[self._edge : self._size - self._edge]
        rows = np.stack([*self._columns(np.zeros(3))[:3], sign])
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
        body, spool = (
            fft.irfft(row, self._size)[self._edge : self._size - self._edge] for row in (self._b, self._s)
        )
        size, hop = round(SEGMENT / self._period), round(HOP / self._period)
        count = (body.size - size) // hop + 1
        if count < 4:
            return 0.0
        places = np.arange(size) + hop * np.arange(count)[:, np.newaxis]
        frequency = fft.rfftfreq(size, self._period)
        inside = (frequency > LOW) & (frequency < HIGH)
        one, other = (fft.rfft(row[places] * np.hanning(size), axis=1)[:, inside] for row in (body, spool))
        cross = other * np.conj(one)
        # Loud lines weigh more, but not with the fourth power of their amplitude.
        cross /= np.sqrt(np.abs(cross) + 1e-3 * np.abs(cross).max() + 1e-300)
        apart, rate, reach = 1, 0.0, LARGEST_RATE * HOP
        while apart <= count // 2:
            seconds = hop * self._period * apart
            turned = np.sum(cross[apart:] * np.conj(cross[:-apart]), axis=0)
            delays = rate * seconds + np.linspace(-reach, reach, 401)
            match = np.real(np.exp(2j * np.pi * np.outer(delays, frequency[inside])) @ turned)
            rate, reach = float(delays[np.argmax(match)]) / seconds, min(reach, AROUND)
            apart *= 2
        return rate

    def step(self, known: PairFit) -> ClockStep | None:
        """Return the best account of the record by a step of one clock; ``None`` where it is too short.

        Args:
            known: gain and corner that the pair has throughout.

        """
        bins = max(1, round(BIN / self._period))
        count = (self._size - 2 * self._edge) // bins
        margin = math.ceil(2.0 * MIXED / BIN)
        if count < 4 * margin:
            return None
        delays = known.delay + STEPS
        sums = self._sums(known, delays, bins, count)
        power = float(sums[delays.size // 2, :, 0, 0].sum())
        if not power > 0.0:
            return None
        far = self._far(known, sums[delays.size // 2], bins, margin)
        if far is not None:
            delays = np.concatenate([delays, far])
            sums = np.concatenate([sums, self._sums(known, far, bins, count)])
        best: ClockStep | None = None
        half = round(MIXED / BIN)
        totals = np.cumsum(np.concatenate([np.zeros((delays.size, 1, 4, 4)), sums], axis=1), axis=1)
        for split in range(margin, count - margin + 1):
            before, after = totals[:, split - half], totals[:, count] - totals[:, split + half]
            kept = before + after
            common = float(_remainder(kept).min())
            valve = float((_remainder(before) + _remainder(after)).min())
            pairs = _remainder(before[:, np.newaxis] + after[np.newaxis])
            first, second = np.unravel_index(int(np.argmin(pairs)), pairs.shape)
            clock = float(pairs[first, second])
            scale = float(kept[STEPS.size // 2, 0, 0])
            found = ClockStep(
                (self._edge + split * bins) * self._period,
                float(delays[second] - delays[first]),
                *(math.sqrt(max(0.0, one) / scale) for one in (common, clock, valve)),
            )
            if best is None or found.clock / max(found.common, 1e-12) < best.clock / max(best.common, 1e-12):
                best = found
        return best

    def _sums(self, known: PairFit, delays: Array, bins: int, count: int) -> Array:
        """Return the normal equations of each piece for each of ``delays``, shape (delays, count, 4, 4).

        Every account of a step is a sum of these.
        """
        sums = np.empty((delays.size, count, 4, 4))
        for place, delay in enumerate(delays):
            rows = np.stack(
                self._columns(np.array([math.log(known.gain), delay, 2.0 * math.pi * known.corner]))
            )
            cut = rows[:, : count * bins].reshape(4, count, bins)
            sums[place] = np.einsum("icn,jcn->cij", cut, cut)
        return sums

    def _far(self, known: PairFit, sums: Array, bins: int, margin: int) -> Array | None:
        """Return delays (s) that the later pieces may have, where the valve of the first ones fails for them.

        ``sums`` are the normal equations of the pieces with the delay ``known``, shape (pieces, 4, 4). The
        motion that this valve predicts from the body's is correlated with the reading; its best matches are
        the delays. ``None`` where the valve of the first pieces explains the later ones.
        """
        splits = np.arange(margin, sums.shape[0] - margin + 1)
        totals = np.cumsum(sums, axis=0)
        before, after = totals[splits - 1], totals[-1] - totals[splits - 1]
        valves = np.linalg.solve(before[:, 1:, 1:], -before[:, 1:, :1])[..., 0]
        account = np.concatenate([np.ones((splits.size, 1)), valves], axis=1)
        # Both over the mean power of a piece, so that the first valve has its largest error behind the step.
        piece = float(totals[-1, 0, 0]) / sums.shape[0]
        left = _remainder(before) / (piece * splits)
        later = np.einsum("ni,nij,nj->n", account, after, account) / (piece * (sums.shape[0] - splits))
        place = int(np.argmax(later - left))
        if later[place] < max(UNEXPLAINED, CHANGED * left[place]):
            return None
        stiffness, damping = valves[place, :2]
        law = stiffness + damping * self._turn
        spool = self._s * np.exp(self._turn * known.delay) / known.gain
        reading = fft.irfft(spool, self._size)
        reading[: self._edge + int(splits[place]) * bins] = 0.0
        reading[self._size - self._edge :] = 0.0
        moved = self._b * law / (law + self._turn**2)
        match = fft.irfft(fft.rfft(reading) * np.conj(moved), self._size)
        lags = np.arange(-round(FARTHEST / self._period), round(FARTHEST / self._period) + 1)
        height = match[lags % self._size]
        peaks = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:]))
        best = peaks[np.argsort(-height[peaks])[:PEAKS]]
        return np.asarray(known.delay + self._period * np.add.outer(lags[best], NEAR).ravel())

    def _columns(self, point: Array) -> tuple[Array, Array, Array, Array]:
        """Return spool, displacement, velocity and its sign, shape (m,), corrected by ``point``."""
        gain, delay, corner = point
        spool = self._s * np.exp(self._turn * delay - gain)
        body = self._b
        if corner >= 0.0:
            spool = spool * (1.0 + corner / self._turn)
        else:
            body = body * (1.0 - corner / self._turn)
        relative = (spool - body) / self._turn
        rows = fft.irfft(np.stack([spool, relative / self._turn, relative]), self._size)
        acceleration, displacement, velocity = rows[:, self._edge : self._size - self._edge]
        speed = SMOOTH * float(np.std(velocity)) + 1e-12
        return acceleration, displacement, velocity, np.tanh(velocity / speed)

    def _left(self, point: Array) -> tuple[Array, Array]:
        """Return what the best valve leaves over the spool's rms, shape (m,), and its three numbers."""
        acceleration, *motion = self._columns(point)
        columns = -np.stack(motion, axis=1)
        scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-300
        columns /= scale
        normal = columns.T @ columns
        values = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(3), columns.T @ acceleration)
        size = float(np.std(acceleration)) + 1e-300
        return (acceleration - columns @ values) / size, values / scale

    def _slopes(self, point: Array, left: Array, free: tuple[int, ...]) -> Array:
        """Return the slopes of what is left over ``free``, in units of their scales, shape (m, len(free))."""
        slopes = np.empty((left.size, len(free)))
        for place, which in enumerate(free):
            moved = point.copy()
            moved[which] += 0.01 * SCALES[which]
            slopes[:, place] = (self._left(moved)[0] - left) / 0.01
        return slopes


def _remainder(sums: Array) -> Array:
    """Return what least squares leave of the first row by the others, from their products (..., 4, 4)."""
    normal, right = sums[..., 1:, 1:], sums[..., 1:, 0]
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = normal / (scale[..., :, np.newaxis] * scale[..., np.newaxis, :]) + 1e-9 * np.eye(3)
    values = np.linalg.solve(scaled, (right / scale)[..., np.newaxis])[..., 0]
    return np.asarray(sums[..., 0, 0] - np.sum(values * right / scale, axis=-1))
