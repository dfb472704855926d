"""What repeats in the remainder of a free run; noise has no pattern.

A likelihood with a noise level for each tile never punishes a loud remainder. Here a remainder counts as
noise only where no pattern is found in it:

- within a window it is coherent with what the body did, through any smooth transfer, as of a lag or a mode;
- powers of displacement, velocity and reading, with coefficients from all other windows, predict it;
- a line in it keeps its phase over the windows, or its size.

The run is free, and its numbers are fitted to it: neither the spool's noise nor an error of the numbers is in
its motion. Of the power of normal noise in a tile, m of K regressors explain a share that has a Beta
distribution, whatever the noise's level, so mean and variance of the sum over all tiles are known. So are the
distributions of the ratio of a line's mean to its scatter over the windows, and of the scatter of its power.

Sources: Bendat and Piersol, Random Data, 2010, ch. 6 and 9 (coherence); Ljung, System Identification, 1999,
ch. 16; Dawid, 1984 (prequential likelihood); Fisher, Tests of significance in harmonic analysis, 1929.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import fft, special
from spool_core.numbers import Array
from spool_sim.observation import Spectrum

from spool_gap.catalogue import EFFECTS
from spool_gap.likelihood.prediction import Prediction, Predictions
from spool_gap.likelihood.rest import Rest, settled
from spool_gap.likelihood.structure import Structure
from spool_gap.likelihood.structure_fit import StructureFit

BODY, MOTION, LINE = "the motion of the body", "the motion of the spool", "a wave"
#: Numbers of a periodic force.
FORCE, FREQUENCY = "force_amplitude", "force_frequency"
#: Lines of a tile at least: three for each regressor.
LEAST_LINES = 12
#: Power of a line of the body's reading over that of a quiet line from which it shows the valve, and not what
#: else shakes both sensors; share of the lines of a band that is quiet at least.
LOUD, QUIET = 30.0, 0.2
#: Sensitivity across the axis that data sheets of accelerometers allow: weaker lines of the body may be that.
ACROSS = 0.05
#: Zero-padding of the spectrum in which a line is looked for, candidates, and windows at least.
PADDING, CANDIDATES, FEWEST = 4, 3, 3
#: Lines by which a line may wander; share of the power in four times as many that it holds in each window.
WANDERS, NARROW = 4, 0.8
#: Lines around each whose median is the level there.
AROUND = 21
#: Keeps quotients finite.
TINY = 1e-300


def patterns_of(predictions: Predictions, fit: StructureFit) -> list[Rest]:
    """Return what may be a pattern in the remainder of ``fit``, the largest share first."""
    with settled(predictions, fit) as enough:
        if not enough:
            return []
        # A hit's time within a sample is not known, and the motion is off after it: its windows do not count.
        hits = [
            term for name in fit.structure.effects if EFFECTS[name].localised for term in EFFECTS[name].terms
        ]
        for part in predictions.parts if hits else ():
            touched = part.force_of(fit.structure, hits) != 0.0
            part.inside = part.inside & ~part.windows_of(touched.astype(np.float64)).any(axis=1)
        found = _patterns(predictions, fit.structure)
    return sorted(found, key=lambda one: one.share, reverse=True)


def phase_kept(predictions: Predictions, fit: StructureFit) -> float:
    """Return how surely the periodic force of ``fit`` is a line that keeps its phase, as ``Rest.gain``.

    Noise in a narrow band, as of a mount that resonates, has a line in each window, with another phase.
    """
    own = fit.structure.moved({FORCE: 0.0})
    looks = [_Remainder(part, own) for part in predictions.parts if part.inside.any()]
    return max((one.kept(fit.structure.values[FREQUENCY])[0] for one in looks), default=0.0)


def _patterns(predictions: Predictions, own: Structure) -> list[Rest]:
    looks = [_Remainder(part, own) for part in predictions.parts if part.inside.any()]
    looks = [one for one in looks if one.finite]
    reading = sum(one.reading for one in looks)
    if reading <= 0.0:
        return []
    lines = [line for one in looks for line in one.lines(reading)]
    return [
        _by_chance((tile for one in looks for tile in one.of_body()), reading),
        _predicted((tile for one in looks for tile in one.of_motion()), reading),
        *lines,
    ]


@dataclass(frozen=True, slots=True)
class _Tile:
    """Power before and after a regression, and the expected rise of its logarithm but for chance.

    Attributes:
        before, left: power.
        lines, regressors: complex numbers.
        common: rise that what else both sensors read may make.
    """

    before: float
    left: float
    lines: int
    regressors: int
    common: float = 0.0

    @property
    def rise(self) -> float:
        return math.log(self.before / self.left)


def _by_chance(tiles: Iterable[_Tile], reading: float) -> Rest:
    """Return the pattern by regressions whose coefficients were fitted in each tile."""
    rise = variance = explained = 0.0
    for one in tiles:
        free = one.lines - one.regressors
        # The power left over that before has the Beta distribution with K - m and m.
        rise += one.rise - one.common - float(special.digamma(one.lines) - special.digamma(free))
        variance += float(special.polygamma(1, free) - special.polygamma(1, one.lines))
        explained += one.before - one.left * one.lines / free
    score = rise / math.sqrt(variance) if variance > 0.0 else 0.0
    gain = -float(special.log_ndtr(-score))
    return Rest(gain, math.sqrt(max(explained, 0.0) / reading), BODY)


def _predicted(tiles: Iterable[_Tile], reading: float) -> Rest:
    """Return the pattern by predictions with coefficients from elsewhere."""
    gain = explained = 0.0
    for one in tiles:
        gain += one.lines * one.rise
        explained += one.before - one.left
    return Rest(max(gain, 0.0), math.sqrt(max(explained, 0.0) / reading), MOTION)


class _Remainder:
    """Remainder of one stretch.

    Attributes:
        reading: power of the spool's reading in the lines that count.
        finite: whether the simulation did not diverge.
    """

    def __init__(self, part: Prediction, own: Structure) -> None:
        self._part, self._own = part, own
        found = part.responses([own])
        self._predicted = found.acceleration[0]
        self._error: Array = part.spool - self._predicted
        self._motion: Array = np.array([found.displacement[0], found.velocity[0]])
        self.finite = bool(np.isfinite(self._error).all() and np.isfinite(self._motion).all())
        self._windows = np.flatnonzero(part.inside)
        self._lines: Spectrum = part.counted_lines(self._error)[self._windows]
        edges = [0]
        for edge in part.bands[1:-1]:
            if min(edge - edges[-1], part.bands[-1] - edge) >= LEAST_LINES:
                edges.append(edge)
        self._bands = [slice(begin, end) for begin, end in pairwise([*edges, part.bands[-1]])]
        self.reading = _power(part.counted_lines(part.spool)[self._windows])

    def of_body(self) -> Iterator[_Tile]:
        """Yield regressions on what the body did, through a smooth transfer in each tile."""
        part = self._part
        body = np.abs(part.counted_lines(part.body)[self._windows]) ** 2
        of_all = _level(body)
        through = part.counted_lines(self._predicted)[self._windows]
        # What other numbers of spring and drag would change.
        moved = part.lines_of_forces(self._motion, self._own)[:, self._windows]
        for cut in self._bands:
            slope = np.linspace(-1.0, 1.0, cut.stop - cut.start)
            # A band that nothing stands out of is excited all the time: its own level does not show.
            own_level = _level(body[:, cut])
            quiet = own_level if np.any(body[:, cut] > LOUD * own_level) else of_all
            for place in range(self._windows.size):
                loud = body[place, cut] > max(LOUD * quiet, ACROSS**2 * float(body[place].max()))
                if int(loud.sum()) < LEAST_LINES:
                    continue
                own = through[place, cut]
                columns = np.array([own, slope * own, *moved[:, place, cut]])[:, loud]
                common = float(np.sum(quiet / body[place, cut][loud]))
                lines = self._lines[place, cut][loud]
                scaled = (columns / (np.linalg.norm(columns, axis=1, keepdims=True) + TINY)).T
                basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
                basis = basis[:, sizes > 1e-6 * sizes[0]]
                before = _power(lines) + TINY
                left = max(before - _power(basis.conj().T @ lines), 1e-9 * before)
                yield _Tile(before, left, lines.size, basis.shape[1], common)

    def of_motion(self) -> Iterator[_Tile]:
        """Yield predictions by powers of the motion with the coefficients of all other windows."""
        part = self._part
        z, v = (row / (np.std(row) + TINY) for row in self._motion)
        side, seen = np.sign(v), self._predicted / (np.std(self._predicted) + TINY)
        forces = np.array([z, v, z * z, z * v, v * v, z**3, v**3, z * z * v, v * np.abs(v), side, side * z])
        rows = np.concatenate([
            part.lines_of_forces(forces, self._own),
            part.counted_lines(np.array([seen, seen**2, seen**3])),
        ])[:, self._windows]  # fmt: skip
        power = np.mean(np.abs(self._lines) ** 2, axis=0)
        level = np.concatenate(
            [np.full(cut.stop - cut.start, power[cut].mean() + TINY) for cut in self._bands]
        )
        scaled = (one / np.sqrt(level) for one in (rows, self._lines))
        columns, error = (np.concatenate([one.real, one.imag], axis=-1) for one in scaled)
        columns = columns / (np.sqrt(np.mean(columns**2, axis=(1, 2), keepdims=True)) + TINY)
        products = np.einsum("qwn,pwn->wqp", columns, columns)
        seen_there = np.einsum("qwn,wn->wq", columns, error)
        for place in range(self._windows.size):
            others = products.sum(axis=0) - products[place], seen_there.sum(axis=0) - seen_there[place]
            found = np.linalg.lstsq(others[0], others[1], rcond=1e-6)[0]
            before = np.sum(error[place].reshape(2, -1) ** 2, axis=0)
            left = np.sum((error[place] - found @ columns[:, place]).reshape(2, -1) ** 2, axis=0)
            for cut in self._bands:
                sums = [float(np.sum((one * level)[cut])) + TINY for one in (before, left)]
                yield _Tile(sums[0], sums[1], cut.stop - cut.start, 0)

    def lines(self, reading: float) -> Iterator[Rest]:
        """Yield what stands out of the spectrum most, with how surely its phase stays."""
        part, count = self._part, self._windows.size
        if count < FEWEST:
            return
        inside = np.zeros(part.windows, dtype=np.bool_)
        inside[self._windows] = True
        row = self._error * part.samples_of(inside)
        cut = part.windows_of(row)
        frequency = fft.rfftfreq(PADDING * row.size, part.period)
        near = np.searchsorted(part.lines, frequency).clip(0, part.lines.size - 1)
        level = _median_around(np.mean(np.abs(self._lines) ** 2, axis=0))[near] + TINY
        compared = np.abs(part.lines[near] - frequency) < 1.0
        power = np.where(compared, np.abs(fft.rfft(row, PADDING * row.size)) ** 2 / level, 0.0)
        for _ in range(CANDIDATES):
            line = float(frequency[np.argmax(power)])
            gain, size = self.kept(line)
            wave = np.zeros(part.size)
            wave[: cut.size] = (size * np.exp(2j * np.pi * line * self._time)).real.ravel()
            share = math.sqrt(_power(part.counted_lines(wave)[self._windows]) / reading)
            if gain < (steady := self._steady(line, reading)).gain:
                gain, share = steady.gain, steady.share
            yield Rest(gain, share, f"{LINE} of {line:.4g} Hz")
            power[np.abs(frequency - line) < 2.0] = 0.0

    def kept(self, line: float) -> tuple[float, complex]:
        """Return how surely a line (Hz) keeps its phase over the windows, and its complex size, m/s^2."""
        part, count = self._part, self._windows.size
        rows = part.windows_of(self._error * part.counted)[self._windows]
        taper = np.hanning(rows.shape[1])
        turned = rows * np.exp(-2j * np.pi * line * self._time[self._windows]) * taper
        sizes = 2.0 * np.sum(turned, axis=1) / taper.sum()
        mean = complex(sizes.mean())
        ratio = count * abs(mean) ** 2 / (float(np.sum(np.abs(sizes - mean) ** 2)) + TINY)
        # As many independent frequencies are looked at as the record has lines.
        tries = count * part.lines.size
        return max(0.0, (count - 1) * math.log1p(ratio) - math.log(tries)), mean

    def _steady(self, line: float, reading: float) -> Rest:
        """Return how surely a line near ``line`` (Hz), whose frequency may wander, keeps its size.

        The power of noise in a band as narrow as a line has an exponential distribution over the windows.
        Source: Bartlett's test of equal variances, 1937.
        """
        nearest = int(np.argmin(np.abs(self._part.lines - line)))
        power, beside = [], []
        for row in np.abs(self._lines) ** 2:
            peak = nearest + int(np.argmax(row[max(0, nearest - WANDERS) : nearest + WANDERS + 1]))
            peak -= min(nearest, WANDERS)
            power.append(float(row[max(0, peak - 2) : peak + 3].sum()) + TINY)
            beside.append(float(row[max(0, peak - 4 * WANDERS) : peak + 4 * WANDERS + 1].sum()) + TINY)
        share = math.sqrt(sum(power) / reading)
        if min(one / other for one, other in zip(power, beside, strict=True)) < NARROW:
            return Rest(0.0, share, LINE)
        count = len(power)
        spread = 2.0 * count * (math.log(sum(power) / count) - sum(map(math.log, power)) / count)
        degrees = 0.5 * (count - 1)
        chance = special.gammainc(degrees, max(0.5 * spread / (1.0 + (count + 1) / (6.0 * count)), 1e-12))
        tries = math.log(self._part.lines.size)
        return Rest(max(0.0, -math.log(max(chance, TINY)) - tries), share, LINE)

    @property
    def _time(self) -> Array:
        """Time of each sample of all windows, s, shape (windows, samples)."""
        shape = self._part.windows_of(self._error).shape
        return np.arange(shape[0] * shape[1], dtype=np.float64).reshape(shape) * self._part.period


def _level(power: Array) -> float:
    """Return the mean of the noise in the lines of ``power``, a share ``QUIET`` of which is noise alone."""
    return float(np.quantile(power, QUIET)) / -math.log1p(-QUIET)


def _power(lines: Spectrum) -> float:
    return float(np.sum(np.abs(lines) ** 2))


def _median_around(level: Array) -> Array:
    """Return the medians of ``level`` (lines,) over the lines around each."""
    half = min(AROUND, level.size - 1) // 2
    padded = np.pad(level, half, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=-1))
