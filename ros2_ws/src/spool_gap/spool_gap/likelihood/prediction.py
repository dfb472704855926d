"""Likelihood of a structure: what it leaves of the spool's reading in a free run.

A structure is the base, effects of the catalogue, parts of the measuring chain and the low-pass of the
logger. Its motion is simulated from the measured body acceleration, and what the spool's channel reads of it
is compared with the record.

The rest is cut into windows of a second and bands of frequency. In each of these tiles it is noise of an
unknown level: its power, or the median of its band where that is more. Neither coloured noise nor noise that
comes and goes needs a model, and a window in which the motion took another branch, as with play, does not
decide. All structures are compared on the same samples.

Source: Whittle, 1953 (likelihood by spectra).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal
from spool_core.numbers import Array
from spool_estimator.identification.free_run import FreeRun, Response, response_of
from spool_sim.model import MODELS
from spool_sim.observation import INSTANTS, Spectrum
from spool_sim.valve import Valve

from spool_gap.likelihood.kernel import Point, SwitchableMotion, steps_a_sample
from spool_gap.likelihood.readings import Mask, Readings, averaged, bridged
from spool_gap.likelihood.structure import DELAY, GAIN, Structure

#: Upper end of the band that is compared, over the sample rate.
UPPER = 0.45
#: s of a window, bands of frequency, and lines of a band at least.
WINDOW, BANDS, LINES = 1.0, 12, 6
#: Share of the spool's white noise, in power, that stands for rounding and keeps logarithms finite.
LEAST_POWER = 0.0125
#: m/s^2: errors of a simulation that diverges.
FAR = 1e3
#: Excerpts in which structures are fitted briefly, s of each, and windows behind the run-in that count.
EXCERPTS, EXCERPT, COUNTED = 2, 5.5, 4


class Prediction:
    """Predictions of one stretch of a record by structures of one valve.

    Attributes:
        readings, valve: as given, averaged where they are sampled faster than is needed.
        run: the free run.
        period: s between samples; ``size``: how many are compared; ``seconds``: their time.
        time: of the first sample that is compared, s.
        lines: frequencies that are compared, Hz, shape (lines,).
        windows: of a second; ``inside``: those whose errors count, shape (windows,).
        spool, body: measured, m/s^2, shape (n,); of the body with its noise.
        plain: all tiles have one level: such fits converge from afar.
        beside: at instants, too, samples beside jumps count: else low-passes could not be compared.
    """

    def __init__(
        self,
        readings: Readings,
        valve: Valve,
        motions: Sequence[SwitchableMotion],
        restarts: float = math.inf,
    ) -> None:
        """Lay out the tiles.

        Args:
            readings: of at least three windows.
            valve: as described.
            motions: kernels, the quickest first; the first one that has all terms of a structure runs it.
            restarts: s after which the free run starts again from the measured motion.

        Raises:
            InputError: the stretch is too short.
        """
        self.valve, self.motions = valve, tuple(motions)
        self.readings = readings = averaged(readings)
        self.period = readings.period
        cleaned = replace(readings.record, body=readings.body, spool=readings.spool, oil_temperature=None)
        self.run = FreeRun([cleaned], MODELS["fluid"], valve, window=restarts)
        first, *_, last = (*self.run.windows, self.run.windows[-1])
        cut = self._compared = slice(first.start, last.stop)
        self.spool, self.body = readings.spool[cut], readings.record.body[cut]
        self._railed = np.flatnonzero(~np.isnan(readings.rail[cut]))
        self._rails = readings.rail[cut][self._railed]
        self.size = self.spool.size
        self.seconds = self.size * self.period
        self.time = readings.time + first.start * self.period
        self._window = round(WINDOW / self.period)
        self.windows = self.size // self._window
        frequency = fft.rfftfreq(self._window, self.period)
        low = max(readings.low_cut, readings.noise.noisy_below, 1.5)
        hummed = np.zeros(frequency.size, dtype=np.bool_)
        for line in readings.hum:
            hummed |= np.abs(frequency - line) < 1.5 / WINDOW
        self._places = np.flatnonzero((frequency >= low) & (frequency < UPPER / self.period) & ~hummed)
        self.lines: Array = frequency[self._places]
        self._edges = _edges(self.lines)
        self._hum = _waves(readings.hum, self._window, self.period)
        self._taper = signal.windows.tukey(self._window, 0.1)
        self._lines_of_hum: Spectrum = fft.rfft(self._hum.T * self._taper, axis=-1)[..., self._places]
        self.held: Mask = np.zeros(self.windows, dtype=np.bool_)
        self.inside: Mask = ~self.held
        self._steps: dict[tuple[object, ...], int] = {}
        self.plain, self.beside = False, False
        # Power of a line that rounding stands for.
        density = self.readings.noise.spool * LEAST_POWER
        self._floor = max(density * 0.5 / self.period * float(np.sum(self._taper**2)), 1e-12)
        self._length = fft.next_fast_len(self.size, real=True)
        self._every_line: Array = fft.rfftfreq(self._length, self.period)
        self.count(readings.counted[cut].astype(np.float64))

    def count(self, counted: Array) -> None:
        """Count the samples with 1 in ``counted`` (n,), and no others, from now on."""
        self.counted = counted
        rows = self.windows_of(counted)
        self._kept = rows.mean(axis=1)
        self._broken = np.flatnonzero((self._kept < 1.0) & (self._kept > 0.0))
        line = np.linspace(-1.0, 1.0, self._window)
        trends = rows[self._broken, :, np.newaxis] * np.stack([np.ones_like(line), line], axis=1)
        self._trends: Array = np.linalg.qr(trends)[0]

    def hold_out(self, held: Mask) -> None:
        """Hold out the windows ``held`` (windows,): they do not count."""
        self.held, self.inside = held, ~held

    @property
    def numbers(self) -> float:
        """Count of real numbers that are compared."""
        return float(self._freedom().sum())

    # Prediction -----------------------------------------------------------------------------------------

    def responses(self, structures: Sequence[Structure]) -> Response:
        """Return what ``structures``, which have the same effects and parts, predict of the record."""
        first = structures[0]
        motion, substeps = self._run_by(first)
        run = self.run.of(MODELS["fluid"], motion)
        run.substeps = [substeps]
        sets = np.array([motion.row(one.terms, one.values) for one in structures])
        found = run.responses(sets, [one.reading for one in structures])
        begins = [window.start - run.windows[0].start for window in run.windows]
        rows = [
            (one.acceleration, one.displacement, one.velocity, one.jumps + begin)
            for one, begin in zip(found, begins, strict=True)
        ]
        return Response(*(np.concatenate(row, axis=-1) for row in zip(*rows, strict=True)))

    def errors(self, structures: Sequence[Structure]) -> Spectrum:
        """Return what ``structures``, of the same effects and parts, leave, shape (s, windows, lines).

        At instants a sample is before or after a jump of the motion, and the noise of the body moves the
        jump: the two samples beside each jump of the first structure do not count. Where the sensor clips,
        what is predicted beyond its limit leaves nothing.
        """
        found = self.responses(structures)
        rows = self.spool - found.acceleration
        if structures[0].observation.kind == INSTANTS and found.jumps.size and not self.beside:
            before = np.floor(found.jumps + structures[0].values[DELAY] / self.period).astype(int)
            beside = np.unique(np.clip(np.concatenate([before, before + 1]), 0, self.size - 1))
            count = np.bincount(beside // self._window, minlength=self.windows + 1) / self._window
            rows *= np.repeat(1.0 / np.sqrt(1.0 - np.minimum(count, 0.5)), self._window)[: self.size]
            rows[:, beside] = 0.0
        far = ~(np.abs(rows).max(axis=1) < FAR)
        lines = self.counted_lines(np.clip(np.nan_to_num(rows, nan=FAR), -FAR, FAR))
        if self._railed.size:
            short = self._rails - np.nan_to_num(found.acceleration[:, self._railed])
            rows = np.zeros_like(rows)
            rows[:, self._railed] = np.where(self._rails > 0.0, short.clip(0.0, FAR), short.clip(-FAR, 0.0))
            lines += self.lines_of(rows)
        lines[far] = FAR
        return lines

    def _run_by(self, one: Structure) -> tuple[SwitchableMotion, int]:
        """Return the kernel that runs ``one``, and its steps a sample."""
        motion = next(entry for entry in self.motions if entry.has(one.terms))
        # Within a twentieth of each number the same steps will do.
        rounded = {name: float(f"{one.values[name]:.2g}") for name in sorted(one.values)}
        key = (one.terms, tuple(rounded.items()))
        if key not in self._steps:
            highest = min(self.readings.noise.high, 0.4 / self.period)
            self._steps[key] = steps_a_sample(
                Point(one.terms, rounded), self.period, highest, self.run.accelerations[0]
            )
        return motion, self._steps[key]

    def bridged(self, one: Structure) -> Prediction:
        """Return this with the samples that the spool lacks bridged by the reading that ``one`` predicts."""
        guess = self.readings.spool.copy()
        guess[self._compared] = self.responses([one]).acceleration[0]
        found = Prediction(bridged(self.readings, guess), self.valve, self.motions)
        found.hold_out(self.held)
        found.run.work.spent = self.run.work.spent
        return found

    def counted_lines(self, rows: Array) -> Spectrum:
        """Return the spectra of what counts of ``rows`` (..., n), shape (..., windows, lines).

        From windows in which samples do not count the trend of those that do is taken away: a bias would
        leak to every line from where it is cut out.
        """
        cut = self.windows_of(rows * self.counted)
        if self._broken.size:
            own = cut[..., self._broken, :]
            shares = np.matmul(own[..., np.newaxis, :], self._trends)
            cut[..., self._broken, :] = own - np.matmul(shares, self._trends.swapaxes(-1, -2))[..., 0, :]
        return self._spectra(cut)

    def lines_of(self, rows: Array) -> Spectrum:
        """Return the spectra of the windows of ``rows`` (..., n), shape (..., windows, lines)."""
        return self._spectra(self.windows_of(rows))

    def _spectra(self, cut: Array) -> Spectrum:
        lines: Spectrum = fft.rfft(cut * self._taper, axis=-1)[..., self._places]
        if self._hum.size:
            lines -= (cut @ self._hum) @ self._lines_of_hum
        return lines

    @property
    def bands(self) -> list[int]:
        """Places among ``lines`` where bands begin, and their number."""
        return [int(edge) for edge in self._edges]

    def windows_of(self, rows: Array) -> Array:
        """Return ``rows`` (..., n) cut into windows, shape (..., windows, samples)."""
        return rows[..., : self.windows * self._window].reshape(*rows.shape[:-1], self.windows, self._window)

    def samples_of(self, windows: Mask) -> Mask:
        """Return which samples are in ``windows`` and count, shape (n,)."""
        inside = np.zeros(self.size, dtype=np.bool_)
        inside[: self.windows * self._window] = np.repeat(windows, self._window)
        return inside & (self.counted > 0.5)

    def noise_density(self, one: Structure) -> Array:
        """Return the one-sided density that both sensors' noise leaves of ``one``, (m/s^2)^2/Hz, (lines,)."""
        turn = 2j * np.pi * self.lines
        mass, stiffness, damping = _linear(one)
        passed = (damping * turn + stiffness) / (mass * turn**2 + damping * turn + stiffness)
        noise = self.readings.noise
        # Above the excitation the body's noise is filtered off.
        density = np.interp(self.lines, *self.readings.resting)
        of_body = np.where(self.lines < 1.5 * noise.high, density, 0.0) * np.abs(passed) ** 2
        return np.asarray(noise.spool + of_body)

    def density_of(self, power: Array) -> Array:
        """Return the one-sided density of lines of mean ``power`` (lines,), (m/s^2)^2/Hz."""
        return np.asarray(2.0 * power * self.period / float(np.sum(self._taper**2)))

    def noise_of(self, one: Structure, windows: int) -> float:
        """Return the power that noise alone leaves in the lines of ``windows`` of them."""
        density = self.noise_density(one)
        return float(windows * np.sum(density) * float(np.sum(self._taper**2)) / (2.0 * self.period))

    def lines_of_forces(self, forces: Array, one: Structure) -> Spectrum:
        """Return what small ``forces`` (q, n) add to the errors of ``one``, shape (q, windows, lines).

        Forces of a term, N, through the linear valve that ``one`` has.
        """
        turn = 2j * np.pi * self._every_line
        mass, stiffness, damping = _linear(one)
        moved = -(turn**2) / (mass * turn**2 + damping * turn + stiffness)
        read = response_of(one.reading.of("spool"), self._every_line) * (1.0 + one.values[GAIN])
        lines = fft.rfft(forces, self._length, axis=-1) * moved * read
        return -self.counted_lines(fft.irfft(lines, self._length, axis=-1)[..., : self.size])

    def force_of(
        self, one: Structure, terms: Sequence[str], values: Mapping[str, float] | None = None
    ) -> Array:
        """Return the force of ``terms`` along the motion of ``one``, by its or other ``values``, N, (n,)."""
        motion = next(entry for entry in self.motions if entry.has((*one.terms, *terms)))
        found = self.responses([one])
        rows = np.array([motion.row(("inertia", *terms), values or one.values)])
        first = round(self.time / self.period)
        force = motion.forces(
            found.displacement[0], found.velocity[0], rows, sample_period=self.period, first_sample=first
        )
        return np.asarray(force[0])

    # Likelihood -----------------------------------------------------------------------------------------

    def log_likelihood(self, lines: Spectrum) -> float:
        """Return the log likelihood of the errors ``lines`` (windows, lines) but for a constant."""
        return float(self.by_window(lines).sum())

    def by_window(self, lines: Spectrum) -> Array:
        """Return the log likelihood of each window, shape (windows,); 0 for those that do not count."""
        power, levels = self._powers(lines) + self._floor, self._levels(lines) + self._floor
        return np.asarray(-0.5 * np.sum(self._freedom() * (np.log(levels) + power / levels), axis=1))

    def weights(self, lines: Spectrum) -> Array:
        """Return the root of 1 over the level of each line's tile, shape of ``lines``."""
        kept = np.sqrt(self.inside * np.maximum(self._kept, 0.0))[:, np.newaxis]
        weights = kept / np.sqrt(self._levels(lines) + self._floor)
        return np.repeat(weights, np.diff(self._edges), axis=1)

    def weighed(self, lines: Spectrum, weights: Array) -> Array:
        """Return ``lines`` (..., windows, lines) times ``weights`` as real numbers, shape (..., numbers)."""
        inside = (lines * weights)[..., self.inside, :]
        flat = inside.reshape(*lines.shape[:-2], -1)
        return np.concatenate([flat.real, flat.imag], axis=-1) * math.sqrt(2.0)

    def _powers(self, lines: Spectrum) -> Array:
        """Return the mean power of a line in each tile, shape (windows, bands)."""
        power = np.add.reduceat(np.abs(lines) ** 2, self._edges[:-1], axis=1)
        return np.asarray(power / np.diff(self._edges) / np.maximum(self._kept[:, np.newaxis], 0.05))

    def _levels(self, lines: Spectrum) -> Array:
        """Return the level of noise in each tile, shape (windows, bands)."""
        power = self._powers(lines)
        if self.plain:
            freedom = self._freedom()
            return np.full(power.shape, float((power * freedom).sum()) / max(float(freedom.sum()), 1.0))
        usual = np.median(power[self.inside], axis=0) if self.inside.any() else np.zeros(power.shape[1])
        return np.maximum(power, usual)

    def _freedom(self) -> Array:
        """Return how many real numbers each tile holds, shape (windows, bands)."""
        kept = self._kept * self.inside
        return np.asarray(2.0 * np.diff(self._edges)[np.newaxis, :] * kept[:, np.newaxis])


class Predictions:
    """Predictions of several stretches of one valve, as if they were one: same methods, lists of arrays."""

    def __init__(self, parts: Sequence[Prediction]) -> None:
        """Take ``parts`` together."""
        self.parts = tuple(parts)
        self.seconds = max(part.time + part.seconds for part in parts)

    def excerpt(self) -> Predictions:
        """Return this for excerpts with much motion, spread over the time, or for all of a short one.

        Free runs start again in each window there: after some blows two motions that begin alike differ.
        """
        counting = [one for one in self.parts if one.inside.any()] or list(self.parts)
        short = sum(part.seconds for part in self.parts) <= EXCERPTS * EXCERPT
        found = []
        for part in () if short else counting:
            length = round(EXCERPT / part.period)
            count = max(1, round(EXCERPTS * part.seconds / sum(one.seconds for one in self.parts)))
            edges = np.linspace(0, part.readings.spool.size, count + 1).astype(int).tolist()
            for begin, end in pairwise(edges):
                if end - begin < length:
                    continue
                starts = [*range(begin, end - length, max(1, length // 8)), end - length]
                # Fourth powers: what is hit now and then is in few samples. The run-in does not count.
                edge, counted = part.run.windows[0].start, round(WINDOW / part.period) * COUNTED
                squares = part.readings.spool**2
                power = [float(np.mean(squares[one + edge : one + edge + counted] ** 2)) for one in starts]
                first = starts[int(np.argmax(power))]
                found.append(part.readings.part(first, first + length))
        own, every = self.parts[0], [one.readings for one in counting]
        for readings in (found, every):  # all of the excerpts may be clipped
            brief = Predictions([
                Prediction(one, own.valve, own.motions, WINDOW) for one in readings or every
            ])  # fmt: skip
            brief.seconds = self.seconds
            if brief.numbers > 0.0:
                break
        return brief

    @property
    def clipped(self) -> bool:
        """Whether the spool's channel clips."""
        return any(not np.isnan(part.readings.rail).all() for part in self.parts)

    def bridge(self, one: Structure) -> None:
        """Bridge the samples that the spool lacks by the reading that ``one`` predicts."""
        self.parts = tuple(part.bridged(one) for part in self.parts)

    @contextmanager
    def by_squares(self) -> Iterator[None]:
        """Give all tiles one level while this lasts."""
        for part in self.parts:
            part.plain = True
        try:
            yield
        finally:
            for part in self.parts:
                part.plain = False

    @property
    def work(self) -> float:
        """Steps of integration so far."""
        return sum(part.run.work.spent for part in self.parts)

    def hold_out(self, held: Sequence[Mask]) -> None:
        """Hold out the windows ``held`` of each part."""
        for part, windows in zip(self.parts, held, strict=True):
            part.hold_out(windows)

    @property
    def numbers(self) -> float:
        """Count of real numbers that are compared."""
        return sum(part.numbers for part in self.parts)

    def errors(self, structures: Sequence[Structure]) -> list[list[Spectrum]]:
        """Return the error lines of each of ``structures`` in each part."""
        found = [part.errors(structures) for part in self.parts]
        return [[lines[number] for lines in found] for number in range(len(structures))]

    def log_likelihood(self, lines: Sequence[Spectrum]) -> float:
        """Return the log likelihood of ``lines``, a spectrum a part."""
        return sum(part.log_likelihood(one) for part, one in zip(self.parts, lines, strict=True))

    def left(self, lines: Sequence[Spectrum]) -> float:
        """Return the rms of ``lines`` over that of the spool's reading, in the windows that count."""
        sums = np.zeros(2)
        for part, one in zip(self.parts, lines, strict=True):
            rows = (one[part.inside], part.counted_lines(part.spool)[part.inside])
            sums += [float(np.sum(np.abs(row) ** 2)) for row in rows]
        return math.sqrt(sums[0] / max(sums[1], 1e-300))

    def by_window(self, lines: Sequence[Spectrum]) -> Array:
        """Return the log likelihood of each window of all parts that counts."""
        rows = zip(self.parts, lines, strict=True)
        return np.concatenate([part.by_window(one)[part.inside] for part, one in rows])

    def weights(self, lines: Sequence[Spectrum]) -> list[Array]:
        """Return the weights of each part."""
        return [part.weights(one) for part, one in zip(self.parts, lines, strict=True)]

    def weighed(self, lines: Sequence[Spectrum], weights: Sequence[Array]) -> Array:
        """Return ``lines`` times ``weights`` of all parts as real numbers, shape (..., numbers)."""
        rows = zip(self.parts, lines, weights, strict=True)
        return np.concatenate([part.weighed(one, weight) for part, one, weight in rows], axis=-1)


def _linear(one: Structure) -> tuple[float, float, float]:
    """Return mass, stiffness and damping of the linear valve within ``one``."""
    values = one.values
    return values["mass"], values["spring_stiffness"], values.get("viscous_coefficient", 0.0)


def _waves(frequencies: Sequence[float], count: int, period: float) -> Array:
    """Return an orthonormal basis of waves of ``frequencies`` (Hz), shape (count, 2 f)."""
    turns = 2.0 * np.pi * np.outer(np.arange(count) * period, np.asarray(frequencies, dtype=np.float64))
    return np.asarray(np.linalg.qr(np.concatenate([np.cos(turns), np.sin(turns)], axis=1))[0])


def _edges(lines: Array) -> NDArray[np.int64]:
    """Return where bands begin among ``lines``, evenly in the logarithm, with ``LINES`` lines at least."""
    wanted = np.searchsorted(lines, np.geomspace(lines[0], lines[-1], BANDS + 1))
    edges = [0]
    for place in wanted[1:-1].tolist():
        if place - edges[-1] >= LINES and lines.size - place >= LINES:
            edges.append(place)
    return np.array([*edges, lines.size], dtype=np.int64)
