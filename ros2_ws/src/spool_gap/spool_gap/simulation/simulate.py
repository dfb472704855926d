"""Hypotheses simulated: free runs over the windows, fitted and scored with one weight for all of them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal
from spool_estimator.identification.free_run import Window
from spool_estimator.identification.spectra import floor_of, smoothed

from .batches import Batches, Run
from .point import Point
from .segments import Stretch
from .shooting import ringing
from .switchable import SwitchableMotion

Array = NDArray[np.float64]

#: Upper end of the compared band over that of the excitation, and at least so many Hz.
HARMONICS, AT_LEAST = 6.0, 300.0
#: Lines times windows that a density is averaged over, on either side of a line.
SMOOTHED = 24
#: Share of the level that errors keep at high frequency by which they are weighed at least.
LEAST = 0.5
#: Error that a run is given at most, m/s^2: one that diverges costs a number, too.
FAR = 1e6
#: Weighed squares over their expectation from which a window is a bad one.
BAD = 2.0


@dataclass(frozen=True, slots=True)
class _Way:
    """How the errors of a window are weighed: in time, which lines, over what, and without which motion."""

    taper: Array
    band: slice
    scale: Array
    ringing: Array | None


class Simulation:
    """Free runs over the windows of all stretches, with one way to compare and to weigh what they leave.

    What changes that way returns another simulation of the same windows and leaves this one as it is.

    Attributes:
        stretches: as given.
        robust: bad windows are counted by the logarithm of their squares.
        places: stretch, window and whether it is fitted, of each window.
        ringing: mass, stiffness and damping (kg, N/m, N s/m) with which an error of a window's start
            rings; ``None`` where windows have forgotten their start.
        damper: N s/m, between model and measured motion, see :mod:`spool_gap.fitting.synchronised`.
        weighing: another object whenever what is compared, or its weight, has changed.
    """

    def __init__(
        self, stretches: Sequence[Stretch], motions: Sequence[SwitchableMotion], damper: float = 0.0
    ) -> None:
        """Prepare the bands and start with the weight of the channels' noise.

        Args:
            stretches: with their windows.
            motions: kernels, quickest first; the first one that has all terms of a hypothesis steps it.
            damper: that ``stretches`` are synchronised by, N s/m.
        """
        self.stretches = tuple(stretches)
        self.motions = tuple(motions)
        self.damper = damper
        self.places = [
            (stretch, window, training)
            for stretch in stretches
            for window, training in zip(stretch.windows, stretch.training, strict=True)
        ]
        self.density: list[Array] = [np.full(2, s.noise.spool + s.noise.body) for s in stretches]
        self._lines: list[Array] = [np.array([0.0, 0.5 * s.noise.rate]) for s in stretches]
        self.jumps: dict[int, Array] | None = None
        self.ringing: tuple[float, float, float] | None = None
        self.robust = False
        self._ways: dict[int, _Way] = {}
        self.weighing = object()
        self._batches = Batches()
        self._number = {id(stretch): number for number, stretch in enumerate(stretches)}

    def run(self, points: Sequence[Point], chosen: Sequence[int]) -> list[Run]:
        """Simulate ``points`` (with the same terms) over the windows numbered ``chosen``."""
        motion = next(entry for entry in self.motions if entry.has(points[0].terms))
        if self.damper:
            points = [point.damped(self.damper) for point in points]
        return self._batches.run(motion, points, [self.places[place][:2] for place in chosen])

    def errors(self, points: Sequence[Point], chosen: Sequence[int]) -> list[Array]:
        """Return model - measured, m/s^2, shape (s, n) for each window; 0 where a channel clips.

        Compared are means over sample intervals: a jump of friction between two samples moves them in
        proportion to its time, not at chance. Once the jumps are known well enough (``jumps``), samples are
        compared and those next to a jump are left out: sampled jumps are not in the band of the means.
        """
        found = []
        for place, run in zip(chosen, self.run(points, chosen), strict=True):
            stretch, window, _ = self.places[place]
            mask = stretch.kept[window.start : window.stop]
            if self.jumps is None:
                error = run.means - window.measured_means
            else:
                error, mask = run.acceleration - window.measured, mask * self.jumps[place]
            np.clip(error, -FAR, FAR, out=error)
            found.append(np.nan_to_num(error, copy=False, nan=FAR) * mask)
        return found

    def sampled_for(self, point: Point) -> Simulation:
        """Return this, comparing samples next to known jumps of ``point`` where that leaves less."""
        everything = list(range(len(self.places)))
        masks = {
            place: beside_no_jump(run.velocity[0])
            for place, run in zip(everything, self.run([point], everything), strict=True)
        }
        means, samples = self.comparing(None), self.comparing(masks)
        share = float(np.mean(np.concatenate(list(masks.values()))))
        left = [simulation.cost_of(point) for simulation in (means, samples)]
        return samples if left[1] / max(share, 0.2) < left[0] else means

    def cost_of(self, point: Point) -> float:
        """Return the sum of :meth:`costs` that ``point`` leaves in all windows."""
        everything = list(range(len(self.places)))
        return float(self.cost(self.weigh(self.errors([point], everything), everything), everything)[0])

    def comparing(self, jumps: dict[int, Array] | None) -> Simulation:
        """Return this, comparing means over sample intervals, or samples that ``jumps`` keep (1, else 0)."""
        found = self._reweighed()
        found.jumps = jumps
        return found

    def over(self, places: Sequence[tuple[Stretch, Window, bool]]) -> Simulation:
        """Return this over other ``places``, which have the lengths of its own."""
        found = copy.copy(self)
        found.places = list(places)
        return found

    def weigh(self, errors: Sequence[Array], chosen: Sequence[int]) -> Array:
        """Return ``errors`` weighed to variance 1, shape (s, m)."""
        ways = [self._way_of(place, error.shape[-1]) for place, error in zip(chosen, errors, strict=True)]
        lengths: dict[int, list[int]] = {}
        for number, error in enumerate(errors):
            lengths.setdefault(error.shape[-1], []).append(number)
        lines: dict[int, NDArray[np.complex128]] = {}
        for numbers in lengths.values():  # windows of one length together, on all processors
            rows = np.array([errors[number] for number in numbers]) * ways[numbers[0]].taper
            lines.update(zip(numbers, fft.rfft(rows, axis=-1, workers=-1, overwrite_x=True), strict=True))
        parts = []
        for number, way in enumerate(ways):
            own = lines[number][:, way.band] / way.scale
            real = np.concatenate([own.real, own.imag], axis=1)
            if way.ringing is not None:
                real -= (real @ way.ringing) @ way.ringing.T
            parts.append(real)
        return np.concatenate(parts, axis=1)

    def _way_of(self, place: int, length: int) -> _Way:
        """Return how the errors (length,) of the window ``place`` are weighed, worked out once a weight."""
        if place not in self._ways:
            self._ways[place] = self._way(place, length)
        return self._ways[place]

    def _way(self, place: int, length: int) -> _Way:
        """Return how the errors (length,) of the window ``place`` are weighed now."""
        stretch, _, _ = self.places[place]
        number = self._number[id(stretch)]
        taper = signal.windows.tukey(length, 0.1)
        frequency = fft.rfftfreq(length, stretch.record.sample_period)
        band = self.band(stretch, frequency)
        density = np.interp(frequency[band], self._lines[number], self.density[number])
        scale = np.sqrt(density * 0.25 * stretch.noise.rate * float(np.sum(taper**2)))
        start = None if self.ringing is None else self._start(place, taper, band, scale)
        return _Way(taper, band, scale, start)

    def _start(self, place: int, taper: Array, band: slice, scale: Array) -> Array:
        """Return an orthonormal base of what an error of the start makes of a window, shape (m, 2)."""
        assert self.ringing is not None
        _, window, _ = self.places[place]
        period = self.places[place][0].record.sample_period
        rows = ringing(taper.size, window.start - window.first, period, *self.ringing)
        rows = rows * self.places[place][0].kept[window.start : window.stop]
        if self.jumps is not None:
            rows = rows * self.jumps[place]
        lines = fft.rfft(rows * taper, axis=-1)[:, band] / scale
        return np.asarray(np.linalg.qr(np.concatenate([lines.real, lines.imag], axis=1).T)[0])

    def cost(self, weighed: Array, chosen: Sequence[int]) -> Array:
        """Return the sum of :meth:`costs` over the windows, shape (s,)."""
        return np.asarray(self.costs(weighed, chosen).sum(axis=1))

    def costs(self, weighed: Array, chosen: Sequence[int]) -> Array:
        """Return the squares of ``weighed`` (s, m) of each window, shape (s, windows).

        If ``robust``, those of a bad window are counted by their logarithm: few windows in which the spool
        hits a stop would drown all others in which it swings free.
        """
        edges, expected = self.parts(chosen)
        squares = np.add.reduceat(weighed**2, edges[:-1], axis=1)
        if not self.robust:
            return np.asarray(squares)
        bad = np.maximum(squares / expected, 1.0)
        return np.asarray(np.where(bad > 1.0, expected * (1.0 + np.log(bad)), squares))

    def trust(self, weighed: Array, chosen: Sequence[int]) -> Array:
        """Return the root of the share with which each of ``weighed`` (m,) counts, shape (m,)."""
        if not self.robust:
            return np.ones(weighed.size)
        edges, expected = self.parts(chosen)
        squares = np.add.reduceat(weighed**2, edges[:-1])
        return np.repeat(np.sqrt(np.minimum(1.0, expected / np.maximum(squares, 1e-12))), np.diff(edges))

    def smooth(self, changes: Array, most: Array, chosen: Sequence[int]) -> Array:
        """Return 1 where ``changes`` (p, m) of a window's numbers stay within ``most`` (m,), else less."""
        edges, _ = self.parts(chosen)
        largest = np.add.reduceat(changes**2, edges[:-1], axis=1).max(axis=0)
        allowed = np.add.reduceat(most**2, edges[:-1])
        share = np.minimum(1.0, allowed / np.maximum(largest, 1e-30))
        return np.repeat(share, np.diff(edges))

    def parts(self, chosen: Sequence[int]) -> tuple[NDArray[np.int64], Array]:
        """Return where each window begins among weighed numbers, and its squares above which it is bad."""
        sizes = []
        for place in chosen:
            stretch, window, _ = self.places[place]
            lines = fft.rfftfreq(window.stop - window.start, stretch.record.sample_period)
            sizes.append(2 * lines[self.band(stretch, lines)].size)
        return np.concatenate([[0], np.cumsum(sizes)]), BAD * np.array(sizes, dtype=np.float64)

    def _reweighed(self) -> Simulation:
        """Return a copy whose weights are worked out anew."""
        found = copy.copy(self)
        found._ways, found.weighing = {}, object()
        return found

    def counting_robustly(self, *, robust: bool = True) -> Simulation:
        """Return this, counting bad windows by the logarithm of their squares or not."""
        found = copy.copy(self)
        found.robust = robust
        return found

    def weighed_by_channels(self) -> Simulation:
        """Return this with the weight of the channels' noise, counting robustly."""
        found = self._reweighed()
        found.robust = True
        found._lines = [np.array([0.0, 0.5 * s.noise.rate]) for s in self.stretches]
        found.density = [np.full(2, s.noise.spool + s.noise.body) for s in self.stretches]
        return found

    def weighed_like(self, other: Simulation) -> Simulation:
        """Return this, weighing means over intervals as ``other`` does, which has these stretches or more."""
        found = self._reweighed()
        found.robust, found.ringing = other.robust, other.ringing
        numbers = [other._number[id(stretch)] for stretch in self.stretches]
        found.density = [other.density[number] for number in numbers]
        found._lines = [other._lines[number] for number in numbers]
        return found

    def ringing_as(self, mass: float, stiffness: float, damping: float) -> Simulation:
        """Return this with what an error of the windows' starts makes of them taken out of all errors."""
        found = self._reweighed()
        found.ringing = mass, stiffness, damping
        return found

    @staticmethod
    def band(stretch: Stretch, frequency: Array) -> slice:
        """Return the lines that are compared."""
        high = min(0.45 * stretch.noise.rate, max(HARMONICS * stretch.noise.high, AT_LEAST))
        low = max(stretch.low_cut, stretch.noise.noisy_below)
        return slice(int(np.searchsorted(frequency, low)), int(np.searchsorted(frequency, high)))

    def spectra(
        self, errors: Sequence[Array], chosen: Sequence[int], *, median: bool = False
    ) -> list[tuple[Array, Array]]:
        """Return frequency and smoothed density of the first row of ``errors`` for each stretch.

        The mean over the windows, or their ``median``, which a few bad ones do not move.
        """
        found: list[tuple[Array, Array]] = []
        for stretch in self.stretches:
            rows = [e[0] for e, place in zip(errors, chosen, strict=True) if self.places[place][0] is stretch]
            if not rows:
                found.append((np.array([0.0, 1.0]), np.zeros(2)))
                continue
            piece = min([*(row.size for row in rows), round(1.0 / stretch.record.sample_period)])
            densities = []
            for row in rows:
                frequency, density = signal.welch(row, stretch.noise.rate, "hann", piece, detrend=False)
                densities.append(density)
            if median and len(rows) > 4:
                middle = np.median(densities, axis=0) / median_over_mean(min(row.size for row in rows), piece)
            else:
                middle = np.mean(densities, axis=0)
            # The peak of a weakly damped valve is narrower than what few windows have to be smoothed by.
            found.append((np.asarray(frequency), smoothed(np.asarray(middle), SMOOTHED // len(rows))))
        return found

    def weighed_by(self, errors: Sequence[Array]) -> Simulation:
        """Return this weighing by the spectrum of ``errors`` of the fitted windows, at least by the noise's.

        Half the spool channel's noise is the least; harmonics of friction stand in that: what is left below
        it without them is a noise floor, too.
        """
        found = self._reweighed()
        found._lines, found.density = [], []
        spectra = self.spectra(errors, self.training, median=self.robust)
        for stretch, (frequency, density) in zip(self.stretches, spectra, strict=True):
            least = 0.5 * stretch.noise.spool
            if density.size > 8:
                least = min(least, LEAST * floor_of(density))
            found._lines.append(frequency)
            found.density.append(np.maximum(density, least))
        return found

    def residual_density(self, number: int, frequency: Array) -> Array:
        """Return the density that errors of the stretch of that number are weighed by, (m/s^2)^2/Hz."""
        return np.asarray(np.interp(frequency, self._lines[number], self.density[number]))

    @property
    def training(self) -> list[int]:
        """Numbers of the windows that are fitted."""
        return [number for number, (_, _, training) in enumerate(self.places) if training]

    @property
    def held_out(self) -> list[int]:
        """Numbers of the windows that are held out."""
        return [number for number, (_, _, training) in enumerate(self.places) if not training]

    def measured(self, chosen: Sequence[int]) -> list[Array]:
        """Return the measured spool acceleration of each window, 0 where a channel clips."""
        if self.jumps is not None:
            return [
                self.places[p][1].measured
                * self.places[p][0].kept[self.places[p][1].start : self.places[p][1].stop]
                * self.jumps[p]
                for p in chosen
            ]
        return [
            self.places[p][1].measured_means
            * self.places[p][0].kept[self.places[p][1].start : self.places[p][1].stop]
            for p in chosen
        ]

    def nrmse(self, errors: Sequence[Array], chosen: Sequence[int]) -> Array:
        """Return rms(model - measured) / rms(measured), shape (s,)."""
        power = sum(np.sum(error**2, axis=-1) for error in errors)
        return np.asarray(np.sqrt(power / sum(float(np.sum(row**2)) for row in self.measured(chosen))))


def beside_no_jump(velocity: Array) -> Array:
    """Return 0 for the two samples on each side of a change of sign of ``velocity`` (n,), else 1."""
    sign = np.sign(velocity)
    jumps = np.flatnonzero(sign[1:] != sign[:-1])
    kept = np.ones(velocity.size)
    for offset in (-1, 0, 1, 2):
        kept[np.clip(jumps + offset, 0, velocity.size - 1)] = 0.0
    return kept if kept.mean() > 0.4 else np.ones(velocity.size)


def median_over_mean(length: int, piece: int) -> float:
    """Return the median over the mean of densities from ``length`` samples, cut into pieces that overlap.

    Of a chi-squared number with two degrees of freedom for each piece on its own (Wilson and Hilferty).
    """
    freedom = 2.0 * max(1.0, length / piece)
    return float((1.0 - 2.0 / (9.0 * freedom)) ** 3)
