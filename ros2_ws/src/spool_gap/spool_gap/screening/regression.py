"""Regression of the balance of forces at the measured motion that is quick enough for every hypothesis.

    m s + c z' + k z + F(z, z', t) = 0

Displacement and velocity come from both accelerations without phase. Target and all columns are cut into the
same windows, tapered alike, and weighed by one spectrum: that of the balance's error which the noise of both
channels makes, and of what the richest hypothesis leaves. Gain and delay of the spool's channel are columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal
from spool_estimator.identification.spectra import ZeroPhase, smoothed

from spool_gap.effect import Effect, Motion, Trial
from spool_gap.simulation.segments import Stretch

Array = NDArray[np.float64]

#: Upper end of the band over that of the excitation, and at least so many Hz.
HARMONICS, AT_LEAST = 5.0, 250.0
#: How far a sensor's gain (relative) and delay (s) are expected from 0, rms.
PRIOR_GAIN, PRIOR_DELAY = 0.03, 0.3e-3


@dataclass(frozen=True, slots=True)
class Screened:
    """What the regression says about one effect.

    Attributes:
        effect: of the catalogue.
        gain: fall of the weighted sum of squares, a log likelihood ratio times two.
        values: parameter values to start from.
        trial: the best signature.
        base: stiffness (N/m), damping (N s/m), relative gain and delay (s) of the spool's channel, found
            jointly with it.
    """

    effect: Effect
    gain: float
    values: dict[str, float]
    trial: Trial
    base: Array


@dataclass(slots=True)
class _Piece:
    motion: Motion
    spool: Array
    driven: Array
    slope: Array
    once: Array
    twice: Array
    slices: list[slice]
    taper: Array
    weight: Array
    band: slice


class Balance:
    """The regression over the windows that are fitted."""

    def __init__(self, stretches: Sequence[Stretch], mass: float, stiffness: float, damping: float) -> None:
        """Cut and weigh the stretches; ``stiffness`` and ``damping`` (SI) shape the noise."""
        self.mass = mass
        self._pieces: list[_Piece] = []
        self._base = (stiffness, damping)
        for stretch in stretches:
            piece = self._cut(stretch, stiffness, damping)
            if piece is not None:
                self._pieces.append(piece)

    def _cut(self, stretch: Stretch, stiffness: float, damping: float) -> _Piece | None:
        windows = [w for w, t in zip(stretch.windows, stretch.training, strict=True) if t]
        if not windows:
            return None
        record = stretch.record
        period = record.sample_period
        length = min(w.stop - w.start for w in windows)
        slices = [slice(w.start, w.start + length) for w in windows]
        taper = signal.windows.tukey(length, 0.2)
        frequency = fft.rfftfreq(length, period)
        low = max(2.0 * stretch.low_cut, stretch.noise.noisy_below)
        high = min(0.45 / period, max(HARMONICS * stretch.noise.high, AT_LEAST))
        band = slice(int(np.searchsorted(frequency, low)), int(np.searchsorted(frequency, high)))
        angular = 2j * np.pi * frequency[band]
        seen = damping / angular + stiffness / angular**2
        noise = stretch.noise.spool * np.abs(self.mass + seen) ** 2 + stretch.noise.body * np.abs(seen) ** 2
        velocity_noise = np.sqrt((stretch.noise.spool + stretch.noise.body) / (4.0 * np.pi**2 * low))
        motion = stretch.motion
        conditioning = ZeroPhase(period, stretch.low_cut)
        # Noise of the spool in these columns would be the noise of the target: only what is driven goes in.
        driven = stretch.quiet.apply(record.spool)
        return _Piece(
            Motion(
                motion.displacement, motion.velocity, motion.acceleration,
                np.asarray((record.first_sample + np.arange(record.body.size)) * period), period,
                float(velocity_noise),
                self.mass, stiffness, damping, (), driven, stretch.low_cut,
            ),
            motion.spool, conditioning.apply(driven), conditioning.apply(driven, -1),
            conditioning.apply(driven, 1),
            conditioning.apply(driven, 2), slices, taper,
            # Power of a tapered window of white noise with one-sided density S is S fs sum(taper^2) / 2.
            1.0 / np.sqrt(noise * 0.5 / period * float(np.sum(taper**2))), band,
        )  # fmt: skip

    @property
    def motions(self) -> list[Motion]:
        """The motion of each stretch."""
        return [piece.motion for piece in self._pieces]

    def _weighed(self, rows: Sequence[Array]) -> Array:
        """Return columns (c, n) of each piece as weighed real vectors, shape (m, c)."""
        parts = []
        for piece, columns in zip(self._pieces, rows, strict=True):
            cut = np.stack([columns[:, part] for part in piece.slices], axis=1) * piece.taper
            lines = fft.rfft(cut, axis=-1)[..., piece.band] * piece.weight
            flat = lines.reshape(columns.shape[0], -1)
            parts.append(np.concatenate([flat.real, flat.imag], axis=1).T * np.sqrt(2.0))
        return np.concatenate(parts)

    def prepare(self, accepted: Sequence[Trial] = ()) -> None:
        """Take base, sensor and ``accepted`` effects out of the target."""
        stiffness, damping = self._base
        rows, targets = [], []
        for number, piece in enumerate(self._pieces):
            motion, once, twice = piece.motion, piece.once, piece.twice
            force = self.mass * piece.spool
            columns = [
                motion.displacement,
                motion.velocity,
                -(self.mass * piece.driven + damping * once + stiffness * twice),
                self.mass * piece.slope + damping * piece.driven + stiffness * once,
            ]
            columns += [row for trial in accepted for row in self._own(trial, number)]
            rows.append(np.array(columns))
            targets.append(-force[np.newaxis])
        # Gain and delay are not free: what the data sheet allows counts as a measurement.
        prior = np.zeros((2, rows[0].shape[0]))
        prior[0, 2], prior[1, 3] = 1.0 / PRIOR_GAIN, 1.0 / PRIOR_DELAY
        self._target = np.concatenate([self._weighed(targets)[:, 0], np.zeros(2)])
        columns_ = np.concatenate([self._weighed(rows), prior])
        self._scale = np.linalg.norm(columns_, axis=0)
        self._q, self._r = np.linalg.qr(columns_ / self._scale)
        self._left = self._target - self._q @ (self._q.T @ self._target)
        self._left -= self._q @ (self._q.T @ self._left)

    def _own(self, trial: Trial, number: int) -> Array:
        sizes = [piece.spool.size for piece in self._pieces]
        first = sum(sizes[:number])
        return trial.columns[:, first : first + sizes[number]]

    @property
    def squares(self) -> float:
        """Weighed sum of squares that base and accepted effects leave."""
        return float(self._left @ self._left)

    @property
    def size(self) -> int:
        """Count of weighed numbers."""
        return int(self._left.size)

    def coefficients(self) -> Array:
        """Return the coefficients of the base's columns and the accepted ones."""
        return self._coefficients(np.zeros(self._r.shape[0]))

    def _coefficients(self, taken: Array) -> Array:
        return np.asarray(np.linalg.solve(self._r, self._q.T @ self._target - taken) / self._scale)

    def screen(self, effects: Sequence[Effect], peaks: tuple[float, ...] = ()) -> list[Screened]:
        """Return for each of ``effects`` its best signature, best effect first."""
        found = []
        for entry in effects:
            best = self._best(entry, peaks)
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda screened: -screened.gain)

    def _best(self, entry: Effect, peaks: tuple[float, ...]) -> Screened | None:
        joined = self.joined(peaks)
        best: Screened | None = None
        for trial in entry.trials(joined):
            columns = self._weighed([self._own(trial, n) for n in range(len(self._pieces))])
            scale = np.linalg.norm(columns, axis=0)
            if not np.all(scale > 0.0):
                continue
            columns = np.concatenate([columns / scale, np.zeros((2, columns.shape[1]))])
            inside = self._q.T @ columns
            columns -= self._q @ inside
            solution, _, rank, _ = np.linalg.lstsq(columns, self._left, rcond=1e-6)
            if rank == 0:
                continue
            gain = float(self._left @ (columns @ solution))
            if best is not None and gain <= best.gain:
                continue
            values = entry.values(solution / scale, trial.shape, joined)
            if values is not None:
                best = Screened(entry, gain, values, trial, self._coefficients(inside @ solution)[:4])
        return best

    def joined(self, peaks: tuple[float, ...] = ()) -> Motion:
        """Return the motion of all stretches, one after the other."""
        first = self._pieces[0].motion
        if len(self._pieces) == 1:
            rows = [first.displacement, first.velocity, first.acceleration, first.time, first.reading]
        else:
            rows = [
                np.concatenate([getattr(piece.motion, name) for piece in self._pieces])
                for name in ("displacement", "velocity", "acceleration", "time", "reading")
            ]
        noise = max(piece.motion.velocity_noise for piece in self._pieces)
        z, v, a, time, reading = rows
        return Motion(
            z, v, a, time, first.period, noise, self.mass, *self._base, peaks, reading, first.low_cut
        )

    def reweigh(self) -> None:
        """Weigh by what is left where that exceeds the noise."""
        first = 0
        for piece in self._pieces:
            count = piece.weight.size
            total = 2 * count * len(piece.slices)
            part = self._left[first : first + total].reshape(2, len(piece.slices), count)
            first += total
            power = np.mean(np.sum(part**2, axis=0), axis=0) / 2.0
            piece.weight /= np.sqrt(np.maximum(1.0, smoothed(power, 3, 0.1)))
