"""Likelihood of a structure: errors of predicting each sample of the spool from those before it.

A structure is the base, effects of the catalogue and parts of the measuring chain. Its motion is
simulated from the measured body acceleration, and after each sample the error of the predicted spool
acceleration corrects displacement and velocity by constant factors: those of the stationary Kalman
filter of the valve as described, whose input noise is ``looseness`` of the excitation or the body
sensor's noise, whichever is larger. For a linear valve the errors are those of a free run through a
monic filter, so that no information is lost; where the motion is sensitive to its start (play, stops),
the correction keeps the simulated motion at the measured one. A loose correction follows any motion:
from there fits converge from afar, and are then tightened.

The errors are cut into windows of a second and bands of frequency. In each of these tiles they are noise
of an unknown level, whose maximum-likelihood estimate is their power, so that the log likelihood is the
sum of -n/2 log(power): neither coloured noise nor noise that comes and goes needs a model, and all
structures are compared on the same samples.

Sources: Ljung, System Identification, 2nd ed., 1999, ch. 7 (prediction errors, innovations form);
Whittle, 1953 (likelihood by spectra).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft, interpolate, linalg, signal
from spool_core.numbers import Array
from spool_estimator.identification.spectra import ZeroPhase
from spool_sim.integration.composed_motion import Correction
from spool_sim.valve import Valve

from spool_gap.likelihood.kernel import Point, SwitchableMotion, steps_a_sample
from spool_gap.likelihood.readings import Readings, bridged
from spool_gap.likelihood.structure import DELAY, GAIN, SMALLEST, ChainPart, Spectrum, Structure, inverse

Mask = NDArray[np.bool_]

#: Hz: a faster record is averaged to about this rate, 13 samples a period of the highest excitation (150 Hz).
RATE = 2000.0
#: Upper end of the band that is compared over that of the excitation, and at least, Hz.
HARMONICS, AT_LEAST = 5.0, 250.0
#: s of a window, bands of frequency, and lines of a band at least.
WINDOW, BANDS, LINES = 1.0, 12, 6
#: Prediction error over its standard deviation from which no more of it corrects the motion.
LARGEST = 4.0
#: Share of the spool's rms that its noise is taken to be at least, for the correction.
LEAST_NOISE = 0.002
#: Share of the spool's white noise, in power, that stands for rounding and keeps logarithms finite.
LEAST_POWER = 0.0125
#: m/s^2: errors of a simulation that diverges.
FAR = 1e3
#: Speed over its 80 % quantile below which the side of a reversal is not certain.
SLOW = 0.06
#: Excerpts in which structures are fitted briefly, and s of each: whole windows, and what averages round off.
EXCERPTS, EXCERPT = 3, 7.01
#: Looseness of a free run, which is not corrected at all.
FREE = -1.0


@dataclass(frozen=True, slots=True)
class Errors:
    """Prediction errors of s structures.

    Attributes:
        lines: of the windows, in the spool channel's unit, shape (s, windows, lines).
        displacement, velocity: of the first structure, relative to the body, m and m/s, shape (n,).
        series: of the first structure, measured minus predicted, m/s^2, shape (n,).
    """

    lines: Spectrum
    displacement: Array
    velocity: Array
    series: Array


class Prediction:
    """Predictions of one stretch of a record by structures of one valve.

    Attributes:
        readings, valve: as given.
        period: s between the samples that are predicted; ``size``: their number; ``seconds``: their time.
        lines: frequencies that are compared, Hz, shape (lines,).
        windows: of a second; ``inside``: those whose errors count, shape (windows,).
        settled: windows in which a body that clips is known, and half a second before them, shape (windows,).
        spool, body: measured, averaged, m/s^2, shape (n,).
        work: steps of integration so far.
    """

    def __init__(self, readings: Readings, valve: Valve, motions: Sequence[SwitchableMotion]) -> None:
        """Average the readings to about ``RATE`` and lay out the tiles.

        Args:
            readings: of at least three windows.
            valve: gives the corrections.
            motions: kernels, the quickest first; the first one that has all terms of a structure runs it.
        """
        self.readings, self.valve, self.motions = readings, valve, tuple(motions)
        self._every = max(1, math.floor(1.0 / (readings.period * RATE) + 1e-9))
        self.period = readings.period * self._every
        box = np.ones(self._every) / self._every
        averaged, body = (
            np.asarray(np.convolve(row, box, mode="valid")[:: self._every], dtype=np.float64)
            for row in (readings.spool, readings.body)
        )
        self.size = averaged.size - 1
        self.spool: Array = averaged[: self.size]
        self.seconds = self.size * self.period
        self._all_heard = self._heard = self._whole(readings.heard)[: self.size]
        self._there = self._whole(readings.counted)[: self.size]
        self._reversals: Array = np.zeros(self.size)
        self._window = round(WINDOW / self.period)
        self.windows = self.size // self._window
        frequency = fft.rfftfreq(self._window, self.period)
        low = max(readings.low_cut, readings.noise.noisy_below, 1.5)
        high = min(0.45 / self.period, max(HARMONICS * readings.noise.high, AT_LEAST))
        hummed = np.zeros(frequency.size, dtype=np.bool_)
        for line in readings.hum:
            hummed |= np.abs(frequency - line) < 1.5 / WINDOW
        self._places = np.flatnonzero((frequency >= low) & (frequency < high) & ~hummed)
        self.lines: Array = frequency[self._places]
        self._edges = _edges(self.lines)
        self._hum = _waves(readings.hum, self._window, self.period)
        self._taper = signal.windows.tukey(self._window, 0.1)
        self._lines_of_hum: Spectrum = fft.rfft(self._hum.T * self._taper, axis=-1)[..., self._places]
        self._whole_windows: Mask = np.ones(self.windows, dtype=np.bool_)
        self._whole_windows[[0, -1]] = False
        self.inside: Mask = self._whole_windows
        self.held: Mask = np.zeros(self.windows, dtype=np.bool_)
        self.settled: Mask = self._known_body()
        self._dense: dict[tuple[float, ...], tuple[Array, int]] = {}
        self._steps: dict[tuple[object, ...], int] = {}
        self._inputs: dict[tuple[float, ...], Array] = {}
        self._spools: dict[tuple[float, ...], Array] = {}
        self._corrections: dict[float, Correction] = {}
        self.work = 0.0
        # Power of a line that rounding stands for.
        density = self.readings.noise.spool * LEAST_POWER
        self._floor = max(density * 0.5 / self.period * float(np.sum(self._taper**2)), 1e-12)
        self.body: Array = body[: self.size]
        self._length = fft.next_fast_len(self.size, real=True)
        self._every_line: Array = np.maximum(fft.rfftfreq(self._length, self.period), 0.3)
        self.count(self._there)

    def _whole(self, mask: Mask) -> Array:
        """Return 1 where all samples that are averaged are in ``mask``, else 0."""
        missing = np.convolve(~mask, np.ones(self._every), mode="valid")[:: self._every]
        return np.asarray(missing < 0.5, dtype=np.float64)

    def _known_body(self) -> Mask:
        if self.readings.body_limit <= 0.0:
            return np.ones(self.windows, dtype=np.bool_)
        known = self._whole(~self.readings.heard | self.readings.counted) > 0.0
        half = self._window // 2
        ends = (np.arange(self.windows) + 1) * self._window
        return np.array(
            [known[max(0, end - self._window - half) : end].all() for end in ends], dtype=np.bool_
        )

    def count(self, counted: Array) -> None:
        """Count the samples with 1 in ``counted`` (n,), and no others, from now on."""
        self.counted = counted
        rows = counted[: self.windows * self._window].reshape(self.windows, self._window)
        self._kept = rows.mean(axis=1)
        self._broken = np.flatnonzero((self._kept < 1.0) & (self._kept > 0.0))
        line = np.linspace(-1.0, 1.0, self._window)
        trends = rows[self._broken, :, np.newaxis] * np.stack([np.ones_like(line), line], axis=1)
        self._trends: Array = np.linalg.qr(trends)[0]

    def leave_out_reversals(self) -> None:
        """Count no sample whose side of a reversal of the measured motion is not certain.

        There a force that jumps makes an error that depends on the time of the reversal within the sample.
        All structures are compared without these samples. A mean of several samples has no side.
        """
        if self._every > 1:
            return
        relative = ZeroPhase(self.period, self.readings.low_cut).apply(self.spool - self.body, 1)
        velocity = np.asarray(relative)
        slow = SLOW * float(np.quantile(np.abs(velocity), 0.8))
        change = np.maximum(np.abs(np.diff(velocity, append=0.0)), np.abs(np.diff(velocity, prepend=0.0)))
        kept = self.counted * (np.abs(velocity) > np.maximum(change, slow))
        self._reversals = self.counted - kept
        self.use_reversals(counted=False, heard=True)

    def use_reversals(self, *, counted: bool, heard: bool) -> None:
        """Count the samples at reversals or not, and correct the motion by them or not."""
        others = 1.0 - self._reversals
        unheld = np.where(np.repeat(self.held, self._window), 0.0, 1.0)
        unheld = np.concatenate([unheld, np.ones(self.size - unheld.size)])
        self._heard = (self._all_heard if heard else self._all_heard * others) * unheld
        self.count(self._there if counted else self._there * others)

    def hold_out(self, held: Mask) -> None:
        """Hold out the windows ``held`` (windows,): they do not count, and the motion runs free in them."""
        self.held = held & self._whole_windows
        self.inside = self._whole_windows & ~held
        self.use_reversals(counted=False, heard=True)

    @property
    def numbers(self) -> float:
        """Count of real numbers that are compared."""
        return float(self._freedom().sum())

    # Prediction -----------------------------------------------------------------------------------------

    def errors(self, structures: Sequence[Structure], looseness: float) -> Errors:
        """Return the prediction errors of ``structures``, which have the same effects and parts.

        Args:
            structures: with different numbers.
            looseness: share of the excitation's rms that the correction takes for input noise, or ``FREE``.
        """
        first = structures[0]
        motion, substeps = self._run_by(first)
        self.work += float(len(structures) * substeps * self.size)
        body_rows, bodies = _distinct([self._input(one, substeps) for one in structures])
        spool_rows, spools = _distinct([self._corrected_spool(one) for one in structures])
        errors, displacement, velocity = motion.predict_batch(
            bodies,
            spools,
            self._heard,
            np.array([motion.row(one.terms, one.values) for one in structures]),
            rows=(body_rows, spool_rows),
            correction=self._correction(looseness),
            sample_period=self.period,
            substeps=substeps,
            means=self._every > 1,
            begin=self.readings.time,
        )
        far = ~(np.abs(errors).max(axis=1) < FAR)
        seen = np.clip(np.nan_to_num(errors, nan=FAR), -FAR, FAR)
        for number, one in enumerate(structures):
            if one.parts and not far[number]:
                seen[number] = self._as_read(seen[number], one)
        lines = self.counted_lines(seen)
        for number, one in enumerate(structures):
            lines[number] *= self._scale(one, looseness)
            if far[number]:
                lines[number] = FAR
        return Errors(lines, displacement[0], velocity[0], errors[0])

    def errors_near(
        self, one: Structure, lines: Spectrum, near: Sequence[Structure], looseness: float
    ) -> Spectrum:
        """Return the error lines of ``near``, which differ a little from ``one`` in their numbers.

        They are taken from slopes, which come with one run, where the terms of ``one`` allow that. ``lines``
        are those of ``one``, shape (windows, lines).
        """
        motion, substeps = self._run_by(one)
        if not motion.has_slopes(one.terms):
            return self.errors(near, looseness).lines
        # The allowance of a search counts what is learned, not what it costs.
        self.work += float(len(near) * substeps * self.size)
        everyone = (one, *near)
        errors, _, _, slopes = motion.predict_with_slopes(
            self._input(one, substeps),
            self._corrected_spool(one),
            self._heard,
            np.array([motion.row(other.terms, other.values) for other in everyone]),
            forced=_changes([self._input(other, substeps) for other in everyone]),
            shifted=_changes([self._corrected_spool(other) for other in everyone]),
            correction=self._correction(looseness),
            sample_period=self.period,
            substeps=substeps,
            means=self._every > 1,
            begin=self.readings.time,
        )
        if not np.abs(slopes).max(initial=0.0) < np.abs(self.spool).max():
            # A small step changes more than there is: the motion is so sensitive, or the correction unstable.
            return self.errors(near, looseness).lines
        if one.parts:
            response, *changed = (self._flat_response(other) for other in everyone)
            slopes = self._through(slopes, response)
            for number, other in enumerate(changed):
                if not np.array_equal(other, response):
                    slopes[number] += self._through(np.clip(errors, -FAR, FAR), other - response)
        here, *others = (self._scale(other, looseness) for other in everyone)
        return (lines / here + self.counted_lines(slopes)) * np.array(others)

    def _flat_response(self, one: Structure) -> Array:
        """Return the size of the response of the spool's channel at every frequency, but for its gain."""
        return np.asarray(np.abs(one.response("spool", self._every_line)) / (1.0 + one.values[GAIN]))

    def _scale(self, one: Structure, looseness: float) -> Array:
        """Return the factor on the errors of ``one`` in each window and line, shape (windows, lines)."""
        gains = self._gains(one, self.windows)[:, np.newaxis]
        return np.asarray((1.0 + one.values[GAIN]) * self._volume(one, looseness) * gains)

    def _run_by(self, one: Structure) -> tuple[SwitchableMotion, int]:
        """Return the kernel that runs ``one``, and its steps a sample."""
        motion = next(entry for entry in self.motions if entry.has(one.terms))
        # Within a tenth of each number the same steps will do.
        rounded = tuple((name, float(f"{one.values[name]:.1g}")) for name in sorted(one.values))
        key = (one.terms, rounded)
        if key not in self._steps:
            self._steps[key] = steps_a_sample(
                Point(one.terms, one.values), self.period, min(self.readings.noise.high, 0.4 / self.period)
            )
        return motion, self._steps[key]

    def _as_read(self, row: Array, one: Structure) -> Array:
        """Return errors ``row`` (n,) as the spool's channel shows them, but for its gain.

        What the inverse of its response leaves out is not predicted.
        """
        response = self._flat_response(one)
        if np.allclose(response, 1.0):
            return row
        left_out = 1.0 - np.minimum(1.0, response / SMALLEST) ** 2
        return self._through(row, response) + self._through(self.spool, left_out)

    def _through(self, rows: Array, transfer: Spectrum | Array) -> Array:
        """Return ``rows`` (..., n) times ``transfer`` at every frequency of them."""
        lines = fft.rfft(rows, self._length, axis=-1) * transfer
        return np.asarray(fft.irfft(lines, self._length, axis=-1)[..., : self.size])

    def free_run(self, one: Structure, looseness: float) -> tuple[Array, Errors]:
        """Return the reading that ``one`` predicts, m/s^2, (n,), and its motion; free in ``held`` windows."""
        found = self.errors([one], looseness)
        error = found.series * self._gains(one, self.size)
        if one.parts or one.values[GAIN]:
            error = self._through(error, one.response("spool", self._every_line))
        return self.spool - error, found

    def bridged(self, one: Structure, looseness: float) -> Prediction:
        """Return this with the samples that the spool lacks bridged by the reading that ``one`` predicts."""
        predicted, _ = self.free_run(one, looseness)
        middle = (np.arange(self.size) + 0.5) * self._every - 0.5
        spline = interpolate.CubicSpline(middle, predicted, bc_type="natural")
        places = np.clip(np.arange(self.readings.spool.size), middle[0], middle[-1])
        return Prediction(bridged(self.readings, spline(places)), self.valve, self.motions)

    def counted_lines(self, rows: Array) -> Spectrum:
        """Return the spectra of what counts of ``rows`` (..., n), shape (..., windows, lines).

        From windows in which samples do not count the trend of those that do is taken away: a bias would
        leak to every line from where it is cut out.
        """
        cut = self._cut(rows * self.counted)
        if self._broken.size:
            own = cut[..., self._broken, :]
            shares = np.matmul(own[..., np.newaxis, :], self._trends)
            cut[..., self._broken, :] = own - np.matmul(shares, self._trends.swapaxes(-1, -2))[..., 0, :]
        return self._spectra(cut)

    def lines_of(self, rows: Array) -> Spectrum:
        """Return the spectra of the windows of ``rows`` (..., n), shape (..., windows, lines)."""
        return self._spectra(self._cut(rows))

    def _cut(self, rows: Array) -> Array:
        return rows[..., : self.windows * self._window].reshape(*rows.shape[:-1], self.windows, self._window)

    def _spectra(self, cut: Array) -> Spectrum:
        lines: Spectrum = fft.rfft(cut * self._taper, axis=-1)[..., self._places]
        if self._hum.size:
            lines -= (cut @ self._hum) @ self._lines_of_hum
        return lines

    def lines_of_part(
        self, part: ChainPart, values: Mapping[str, float], one: Structure, looseness: float, errors: Spectrum
    ) -> Spectrum:
        """Return what a small ``part`` of the chain adds to the errors of ``one``, over its size.

        Args:
            part: of either channel.
            values: its numbers, with a small size.
            one: without it.
            looseness: of the correction.
            errors: of ``one``.
        """
        size = values[part.parameters[0].name]
        frequency, volume = self._every_line, self._volume(one, looseness)
        share: Spectrum = np.abs(one.response("spool", frequency)) / self._ratio(one, looseness, frequency)
        if part.response is None:
            time = self.readings.time + np.arange(self.size, dtype=np.float64) * self.period
            middle = self.windows_of(time).mean(axis=1)[:, np.newaxis]
            read = self._through(self.spool * time, share)
            return np.asarray(errors * middle - self.counted_lines(read) * volume)
        changed = (part.response(frequency, values) - 1.0) / size
        if part.channel == "spool":
            lines = self.counted_lines(self._through(self.spool, changed * share))
            own = ((part.response(self.lines, values) - 1.0) / size).real
            return np.asarray(errors * own - lines * volume)
        turn = 2j * np.pi * frequency
        mass, stiffness, damping = _linear(one)
        passed = (damping * turn + stiffness) / (mass * turn**2 + damping * turn + stiffness)
        moved = self._through(self.body, changed * passed * share)
        return np.asarray(self.counted_lines(moved) * volume)

    @property
    def bands(self) -> list[int]:
        """Places among ``lines`` where bands begin, and their number."""
        return [int(edge) for edge in self._edges]

    def windows_of(self, row: Array) -> Array:
        """Return ``row`` (n,) cut into windows, shape (windows, samples)."""
        return row[: self.windows * self._window].reshape(self.windows, self._window)

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
        of_body = np.where(self.lines < 1.5 * noise.high, noise.body, 0.0) * np.abs(passed) ** 2
        return np.asarray(noise.spool + of_body)

    def density_of(self, power: Array) -> Array:
        """Return the one-sided density of lines of mean ``power`` (lines,), (m/s^2)^2/Hz."""
        return np.asarray(2.0 * power * self.period / float(np.sum(self._taper**2)))

    def noise_of(self, one: Structure, windows: int) -> float:
        """Return the power that noise alone leaves in the lines of ``windows`` of them."""
        density = self.noise_density(one)
        return float(windows * np.sum(density) * float(np.sum(self._taper**2)) / (2.0 * self.period))

    def lines_of_forces(self, forces: Array, one: Structure, looseness: float) -> Spectrum:
        """Return what small ``forces`` (q, n) add to the errors of ``one``, shape (q, windows, lines).

        Forces of a term, N, through the linear valve that ``one`` has, corrected as the errors are.
        """
        turn = 2j * np.pi * self._every_line
        mass, stiffness, damping = _linear(one)
        moved = -(turn**2) / (mass * turn**2 + damping * turn + stiffness)
        middle = np.exp(0.5 * turn * self.period) if self._every > 1 else 1.0
        share = moved * middle / self._ratio(one, looseness, self._every_line)
        share = share * np.abs(one.response("spool", self._every_line))
        felt = self._through(forces, share)
        return np.asarray(-self.counted_lines(felt) * self._volume(one, looseness))

    def force_of(
        self,
        one: Structure,
        terms: Sequence[str],
        looseness: float,
        values: Mapping[str, float] | None = None,
    ) -> Array:
        """Return the force of ``terms`` along the motion of ``one``, by its or other ``values``, N, (n,)."""
        motion = next(entry for entry in self.motions if entry.has((*one.terms, *terms)))
        errors = self.errors([one], looseness)
        rows = np.array([motion.row(("inertia", *terms), values or one.values)])
        first = round(self.readings.time / self.period)
        force = motion.forces(
            errors.displacement, errors.velocity, rows, sample_period=self.period, first_sample=first
        )
        return np.asarray(force[0])

    def _input(self, one: Structure, substeps: int) -> Array:
        """Return the excitation at the ends and midpoints of all steps, m/s^2."""
        own = [one.values[p.name] for part in one.chain if part.channel == "body" for p in part.parameters]
        key = (float(substeps), one.values[DELAY], *own)
        if key not in self._inputs:
            dense, finer, reach = self._finer_body(one, substeps, own)
            # An averaged sample stands for the middle of its samples, a predicted mean for its beginning.
            ahead = (-0.5 if self._every > 1 else 0.0) - one.values[DELAY] / self.readings.period
            place = (reach + ahead) * finer + np.arange(2 * substeps * self.size + 1) * (
                self._every * finer / (2 * substeps)
            )
            whole = np.floor(place).astype(np.int64)
            share = place - whole
            whole = np.clip(whole, 0, dense.size - 2)
            if len(self._inputs) > 24:
                self._inputs.clear()
            self._inputs[key] = dense[whole] * (1.0 - share) + dense[whole + 1] * share
        return self._inputs[key]

    def _finer_body(self, one: Structure, substeps: int, own: Sequence[float]) -> tuple[Array, int, int]:
        """Return the excitation more densely, how many times, and by how many samples it begins earlier."""
        period, every = self.readings.period, self._every
        finer = max(2, math.ceil(2 * substeps / every))
        reach = min(self.readings.body.size - 1, round(1.0 / period))
        key = (float(finer), *own)
        if key not in self._dense:
            padded = np.pad(self.readings.body, reach, mode="reflect", reflect_type="odd")
            length = fft.next_fast_len(padded.size, real=True)
            lines = fft.rfft(padded, length)
            if own:
                frequency = np.maximum(fft.rfftfreq(length, period), 0.3)
                lines *= inverse(one.response("body", frequency))
            if len(self._dense) > 8:
                self._dense.clear()
            self._dense[key] = fft.irfft(lines, length * finer) * finer, finer
        return *self._dense[key], reach

    def _corrected_spool(self, one: Structure) -> Array:
        """Return the measured spool acceleration without what its channel does to it, m/s^2."""
        own = [one.values[p.name] for part in one.chain if part.channel == "spool" for p in part.parameters]
        key = tuple(own)
        if key not in self._spools:
            row = self.spool
            if one.parts:
                reach = min(row.size - 1, round(0.5 / self.period))
                padded = np.pad(row, reach, mode="reflect", reflect_type="odd")
                length = fft.next_fast_len(padded.size, real=True)
                frequency = np.maximum(fft.rfftfreq(length, self.period), 0.3)
                lines = fft.rfft(padded, length) * inverse(one.response("spool", frequency))
                row = fft.irfft(lines, length)[reach : reach + row.size]
            else:
                row = row / (1.0 + one.values[GAIN])
            if len(self._spools) > 24:
                self._spools.clear()
            self._spools[key] = row / self._gains(one, self.size)
        return self._spools[key]

    def _gains(self, one: Structure, count: int) -> Array:
        """Return the drifting gain of the spool's channel, ``count`` times evenly over the record."""
        rate = one.values["gain_drift_rate"] if "spool_gain_drift" in one.parts else 0.0
        return np.asarray(1.0 + rate * (self.readings.time + (np.arange(count) + 0.5) * self.seconds / count))

    def _correction(self, looseness: float) -> Correction:
        """Return the correction of the stationary Kalman filter of the valve as described."""
        if looseness == FREE:
            return Correction(0.0, 0.0, 1.0)
        if looseness not in self._corrections:
            mass, stiffness = self.valve.moving_mass, self.valve.spring_stiffness
            damping = self.valve.likely_viscous_coefficient
            step = linalg.expm(self.period * np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]]))
            seen = np.array([[-stiffness / mass, -damping / mass]])
            noise = self.readings.noise
            root = math.sqrt(self._every)
            pushed = max(noise.body_rms / root, looseness * float(self.readings.body.std()))
            read = max(noise.spool_rms / root, LEAST_NOISE * float(self.spool.std()))
            moved = np.array([[0.5 * self.period**2], [self.period]]) * pushed
            spread = linalg.solve_discrete_are(
                step.T, seen.T, moved @ moved.T + np.diag([1e-18, 1e-14]), np.array([[read**2]])
            )
            variance = float((seen @ spread @ seen.T)[0, 0]) + read**2
            factors = (spread @ seen.T)[:, 0] / variance
            self._corrections[looseness] = Correction(
                float(factors[0]), float(factors[1]), LARGEST * math.sqrt(variance)
            )
        return self._corrections[looseness]

    def _ratio(self, one: Structure, looseness: float, frequency: Array) -> Spectrum:
        """Return the errors of a free run over those of the corrected one, for the linear valve."""
        mass, stiffness, damping = _linear(one)
        correction = self._correction(looseness)
        step = _step_of(mass, stiffness, damping, self.period)
        factors = np.array([correction.displacement, correction.velocity])
        if self._every > 1:
            seen = (step[1] - np.array([0.0, 1.0])) / self.period
        else:
            seen, factors = np.array([-stiffness / mass, -damping / mass]), step @ factors
        turn = np.exp(2j * np.pi * frequency * self.period)
        determinant = (turn - step[0, 0]) * (turn - step[1, 1]) - step[0, 1] * step[1, 0]
        moved = (
            (turn - step[1, 1]) * factors[0] + step[0, 1] * factors[1],
            step[1, 0] * factors[0] + (turn - step[0, 0]) * factors[1],
        )
        return np.asarray(1.0 + (seen[0] * moved[0] + seen[1] * moved[1]) / determinant)

    def _volume(self, one: Structure, looseness: float) -> Array:
        """Return the size of that ratio in the mean of each band, which keeps likelihoods comparable.

        Over all frequencies the mean of its logarithm is 0 (the filter between both is monic); within the
        band that is compared it is not, and a fit could make errors small by moving them out of the band.
        """
        if looseness == FREE:
            return np.ones(self.lines.size)
        ratio = np.log(np.abs(self._ratio(one, looseness, self.lines)))
        means = np.add.reduceat(ratio, self._edges[:-1]) / np.diff(self._edges)
        return np.repeat(np.exp(means), np.diff(self._edges))

    # Likelihood -----------------------------------------------------------------------------------------

    def log_likelihood(self, lines: Spectrum) -> float:
        """Return the log likelihood of the errors ``lines`` (windows, lines) but for a constant."""
        return float(self.by_window(lines).sum())

    def by_window(self, lines: Spectrum) -> Array:
        """Return the log likelihood of each window, shape (windows,); 0 for those that do not count."""
        return np.asarray(-0.5 * np.sum(self._freedom() * np.log(self._levels(lines) + self._floor), axis=1))

    def weights(self, lines: Spectrum) -> Array:
        """Return the root of 1 over the level of each line's tile, shape of ``lines``.

        A tile that happens to be quiet is not trusted more than three times as much as its band.
        """
        levels = self._levels(lines)
        levels = np.maximum(levels, 0.3 * np.median(levels, axis=0, keepdims=True)) + self._floor
        kept = np.sqrt(self.inside * np.maximum(self._kept, 0.0))[:, np.newaxis]
        return np.repeat(kept / np.sqrt(levels), np.diff(self._edges), axis=1)

    def weighed(self, lines: Spectrum, weights: Array) -> Array:
        """Return ``lines`` (..., windows, lines) times ``weights`` as real numbers, shape (..., numbers)."""
        inside = (lines * weights)[..., self.inside, :]
        flat = inside.reshape(*lines.shape[:-2], -1)
        return np.concatenate([flat.real, flat.imag], axis=-1) * math.sqrt(2.0)

    def _levels(self, lines: Spectrum) -> Array:
        """Return the mean power of a line in each tile, shape (windows, bands)."""
        power = np.add.reduceat(np.abs(lines) ** 2, self._edges[:-1], axis=1)
        return np.asarray(power / np.diff(self._edges) / np.maximum(self._kept[:, np.newaxis], 0.05))

    def _freedom(self) -> Array:
        """Return how many real numbers each tile holds, shape (windows, bands)."""
        kept = self._kept * self.inside
        return np.asarray(2.0 * np.diff(self._edges)[np.newaxis, :] * kept[:, np.newaxis])


class Predictions:
    """Predictions of several stretches of one valve, as if they were one: same methods, lists of arrays."""

    def __init__(self, parts: Sequence[Prediction]) -> None:
        """Take ``parts`` together."""
        self.parts = tuple(parts)
        self.seconds = max(part.readings.time + part.seconds for part in parts)

    def excerpt(self, motions: Sequence[SwitchableMotion]) -> Predictions:
        """Return this for excerpts with much motion, spread over the time, or itself where that is short."""
        if sum(part.seconds for part in self.parts) <= EXCERPTS * EXCERPT:
            return self
        found = []
        for part in (one for one in self.parts if one.inside.any()):
            length = round(EXCERPT / part.readings.period)
            count = max(1, round(EXCERPTS * part.seconds / sum(one.seconds for one in self.parts)))
            edges = np.linspace(0, part.readings.spool.size, count + 1).astype(int).tolist()
            for begin, end in pairwise(edges):
                if end - begin < 3.0 * WINDOW / part.readings.period:
                    continue
                starts = range(begin, max(begin + 1, end - length), max(1, length // 4))
                # Fourth powers: what is hit now and then is in few samples. The outer windows do not count.
                edge = round(WINDOW / part.readings.period)
                squares = part.readings.spool**2
                power = [float(np.mean(squares[one + edge : one + length - edge] ** 2)) for one in starts]
                first = starts[int(np.argmax(power))]
                found.append(part.readings.part(first, min(first + length, end)))
        brief = Predictions([Prediction(one, self.parts[0].valve, motions) for one in found])
        brief.seconds = self.seconds
        return brief if brief.numbers > 0.0 else self  # all of it may be clipped

    @property
    def work(self) -> float:
        """Steps of integration so far."""
        return sum(part.work for part in self.parts)

    @contextmanager
    def reversals(self, *, counted: bool, heard: bool) -> Iterator[None]:
        """Count samples at reversals or not, and hear them or not, while this lasts."""
        for part in self.parts:
            part.use_reversals(counted=counted, heard=heard)
        try:
            yield
        finally:
            for part in self.parts:
                part.use_reversals(counted=False, heard=True)

    def hold_out(self, held: Sequence[Mask]) -> None:
        """Hold out the windows ``held`` of each part."""
        for part, windows in zip(self.parts, held, strict=True):
            part.hold_out(windows)

    @property
    def numbers(self) -> float:
        """Count of real numbers that are compared."""
        return sum(part.numbers for part in self.parts)

    def errors(self, structures: Sequence[Structure], looseness: float) -> list[list[Spectrum]]:
        """Return the error lines of each of ``structures`` in each part."""
        found = [part.errors(structures, looseness).lines for part in self.parts]
        return [[lines[number] for lines in found] for number in range(len(structures))]

    def errors_near(
        self, one: Structure, lines: Sequence[Spectrum], near: Sequence[Structure], looseness: float
    ) -> list[list[Spectrum]]:
        """Return the error lines of each of ``near``, little different from ``one``, in each part."""
        rows = zip(self.parts, lines, strict=True)
        found = [part.errors_near(one, own, near, looseness) for part, own in rows]
        return [[lines[number] for lines in found] for number in range(len(near))]

    def log_likelihood(self, lines: Sequence[Spectrum]) -> float:
        """Return the log likelihood of ``lines``, a spectrum a part."""
        return sum(part.log_likelihood(one) for part, one in zip(self.parts, lines, strict=True))

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


def _step_of(mass: float, stiffness: float, damping: float, period: float) -> Array:
    """Return the transition of displacement and velocity over ``period``: exp(A t) in closed form."""
    half = -0.5 * damping / mass
    root = np.sqrt(complex(half**2 - stiffness / mass))
    grown = np.exp(half * period)
    even = (grown * np.cosh(root * period)).real
    odd = (grown * np.sinh(root * period) / root).real if root else grown * period
    return np.array(
        [[even - half * odd, odd], [-stiffness / mass * odd, even + (-damping / mass - half) * odd]]
    )


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


def _changes(rows: Sequence[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Return how the rows after the first differ from it where they are other objects, and where each is.

    The place is -1 for those that are the same.
    """
    places, distinct = _distinct(rows)
    return distinct[1:] - distinct[0] if len(distinct) > 1 else distinct[:1], places[1:] - 1


def _distinct(rows: Sequence[Array]) -> tuple[NDArray[np.int64], Array]:
    """Return the place of each of ``rows`` among those that are different objects, and these."""
    places: dict[int, int] = {}
    numbers = np.array([places.setdefault(id(row), len(places)) for row in rows], dtype=np.int64)
    return numbers, np.array(list({id(row): row for row in rows}.values()))
