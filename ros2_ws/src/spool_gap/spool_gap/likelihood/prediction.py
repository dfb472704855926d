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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, linalg, signal
from spool_estimator.identification.least_squares import Unknown
from spool_sim.integration.composed_motion import Correction
from spool_sim.terms import term
from spool_sim.valve.description import Valve

from spool_gap.registry import EFFECTS
from spool_gap.simulation.batches import steps_a_sample
from spool_gap.simulation.point import Point
from spool_gap.simulation.switchable import SwitchableMotion

from .chain_part import CHAIN_PARTS, DELAY, GAIN, SPOOL_DELAY, SPOOL_GAIN, ChainPart, Spectrum, inverse
from .readings import Readings

Array = NDArray[np.float64]
Values = Mapping[str, float]

BASE = ("inertia", "spring", "viscous_friction")
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
#: Share of a sample's interval around a reversal in which its side of a jump of friction is not certain.
NEAR = 0.08


@dataclass(frozen=True, slots=True)
class Structure:
    """What is thought to act, with its numbers.

    Attributes:
        effects: ids of the catalogue.
        parts: keys of ``CHAIN_PARTS``.
        values: every number by name, SI.
    """

    effects: tuple[str, ...]
    parts: tuple[str, ...]
    values: Values

    @property
    def terms(self) -> tuple[str, ...]:
        """Force terms that are on."""
        own = (name for effect in self.effects for name in EFFECTS[effect].terms)
        return tuple(dict.fromkeys((*BASE, *own)))

    @property
    def chain(self) -> tuple[ChainPart, ...]:
        """Parts of the measuring chain, with gain and delay of the spool's channel."""
        return (SPOOL_GAIN, SPOOL_DELAY, *(CHAIN_PARTS[key] for key in self.parts))

    def unknowns(self, seconds: float) -> list[Unknown]:
        """Return what a fit of a record of ``seconds`` finds."""
        found = [
            Unknown(p.name, p.unit, p.low, p.high, abs(self.values.get(p.name, p.start)) or p.start)
            for name in BASE
            for p in term(name).parameters
            if p.name != "mass"
        ]
        for effect in self.effects:
            found += EFFECTS[effect].unknowns(self.values, seconds)
        for part in self.chain:
            found += [Unknown(p.name, p.unit, p.low, p.high, p.start, absolute=True) for p in part.parameters]
        return found

    def moved(self, values: Values) -> Structure:
        """Return this with other numbers."""
        return Structure(self.effects, self.parts, {**self.values, **values})

    def response(self, channel: str, frequency: Array) -> Spectrum:
        """Return the factor on the spectrum of ``channel`` at ``frequency`` (Hz, > 0)."""
        found: Spectrum = np.ones(frequency.size, dtype=np.complex128)
        for part in self.chain:
            if part.channel == channel and part.response is not None:
                found = found * part.response(frequency, self.values)
        return found


def structure_of(
    valve: Valve, effects: Sequence[str] = (), parts: Sequence[str] = (), values: Values | None = None
) -> Structure:
    """Return the structure with ``effects`` and ``parts``; what ``values`` do not give starts as declared."""
    known: dict[str, float] = {
        "mass": valve.moving_mass,
        "spring_stiffness": valve.spring_stiffness,
        "viscous_coefficient": valve.likely_viscous_coefficient,
        GAIN: 0.0,
        DELAY: 0.0,
    }
    for effect in effects:
        for name in EFFECTS[effect].terms:
            for parameter in term(name).parameters:
                known.setdefault(parameter.name, parameter.start_for(valve))
    for key in parts:
        for parameter in CHAIN_PARTS[key].parameters:
            known.setdefault(parameter.name, parameter.start)
    return Structure(tuple(effects), tuple(parts), {**known, **(values or {})})


@dataclass(frozen=True, slots=True)
class Errors:
    """Prediction errors of s structures.

    Attributes:
        lines: of the windows, in the spool channel's unit, shape (s, windows, lines).
        displacement, velocity: of the first structure, relative to the body, m and m/s, shape (n,).
    """

    lines: Spectrum
    displacement: Array
    velocity: Array


class Prediction:
    """Predictions of one record by structures of one valve.

    Attributes:
        readings, valve: as given.
        period: s between the samples that are predicted.
        seconds: of the record.
        lines: frequencies that are compared, Hz.
    """

    def __init__(self, readings: Readings, valve: Valve, motions: Sequence[SwitchableMotion]) -> None:
        """Average the readings to about ``RATE`` and lay out the tiles.

        Args:
            readings: of at least three windows.
            valve: gives the corrections.
            motions: kernels, the quickest first; the first one that has all terms of a structure runs it.
        """
        self.readings, self.valve, self._motions = readings, valve, tuple(motions)
        self._every = max(1, math.floor(1.0 / (readings.period * RATE) + 1e-9))
        self.period = readings.period * self._every
        box = np.ones(self._every) / self._every
        self._spool = np.convolve(readings.spool, box, mode="valid")[:: self._every]
        self._heard = self._whole(readings.heard)
        self._counted = self._whole(readings.counted)
        self.size = self._spool.size - 1
        self.seconds = self.size * self.period
        window = round(WINDOW / self.period)
        self._window = window
        self._windows = self.size // window
        frequency = fft.rfftfreq(window, self.period)
        low = max(readings.low_cut, readings.noise.noisy_below, 1.5)
        high = min(0.45 / self.period, max(HARMONICS * readings.noise.high, AT_LEAST))
        self._band = slice(int(np.searchsorted(frequency, low)), int(np.searchsorted(frequency, high)))
        self.lines: Array = frequency[self._band]
        self._edges = _edges(self.lines)
        self._taper = signal.windows.tukey(window, 0.1)
        self._kept = self._counted[: self._windows * window].reshape(self._windows, window).mean(axis=1)
        self._inputs: dict[tuple[float, ...], Array] = {}
        self._spools: dict[tuple[float, ...], Array] = {}
        self._corrections: dict[float, Correction] = {}
        self._floor = self._noise_floor()

    def _whole(self, mask: NDArray[np.bool_]) -> Array:
        """Return 1 where all samples that are averaged are in ``mask``, else 0."""
        missing = np.convolve(~mask, np.ones(self._every), mode="valid")[:: self._every]
        return np.asarray(missing < 0.5, dtype=np.float64)

    @property
    def numbers(self) -> float:
        """Count of real numbers that are compared."""
        return float(self._freedom()[1:-1].sum())

    # Prediction -----------------------------------------------------------------------------------------

    def errors(self, structures: Sequence[Structure], looseness: float) -> Errors:
        """Return the prediction errors of ``structures``, which have the same effects and parts.

        Args:
            structures: with different numbers.
            looseness: share of the excitation's rms that the correction takes for input noise.
        """
        first = structures[0]
        motion = next(entry for entry in self._motions if entry.has(first.terms))
        substeps = steps_a_sample(
            Point(first.terms, first.values), self.period, min(self.readings.noise.high, 0.4 / self.period)
        )
        body_rows, bodies = _distinct([self._input(one, substeps) for one in structures])
        spool_rows, spools = _distinct([self._corrected_spool(one) for one in structures])
        errors, displacement, velocity = motion.predict_batch(
            bodies,
            spools,
            self._heard[: self.size],
            np.array([motion.row(one.terms, one.values) for one in structures]),
            rows=(body_rows, spool_rows),
            correction=self._correction(looseness),
            sample_period=self.period,
            substeps=substeps,
            means=self._every > 1,
        )
        counted = self._counted[: self.size]
        if self._every == 1 and any("sliding_law" in term(name).laws for name in first.terms):
            counted = counted * _certain(velocity[0])
        errors = np.clip(np.nan_to_num(errors, nan=FAR), -FAR, FAR) * counted
        cut = errors[:, : self._windows * self._window].reshape(-1, self._windows, self._window)
        lines = fft.rfft(cut * self._taper, axis=2)[..., self._band]
        for number, one in enumerate(structures):
            gains = self._gains(one, self._windows)[:, np.newaxis]
            size = np.abs(one.response("spool", self.lines)) * self._free_over_corrected(one, looseness)
            lines[number] *= size * gains
        return Errors(lines, displacement[0], velocity[0])

    def _input(self, one: Structure, substeps: int) -> Array:
        """Return the excitation at the ends and midpoints of all steps, m/s^2."""
        own = [one.values[p.name] for part in one.chain if part.channel == "body" for p in part.parameters]
        key = (one.values[DELAY], float(substeps), *own)
        if key not in self._inputs:
            period, every = self.readings.period, self._every
            reach = min(self.readings.body.size - 1, round(1.0 / period))
            padded = np.pad(self.readings.body, reach, mode="reflect", reflect_type="odd")
            length = fft.next_fast_len(padded.size, real=True)
            frequency = fft.rfftfreq(length, period)
            # An averaged sample stands for the middle of its samples, a predicted mean for its beginning.
            ahead = -0.5 * period if every > 1 else 0.0
            turn = np.exp(2j * np.pi * frequency * (ahead - one.values[DELAY]))
            response = inverse(one.response("body", np.maximum(frequency, 0.3)))
            lines = fft.rfft(padded, length) * turn * response
            finer = max(1, math.ceil(2 * substeps / every))
            dense = fft.irfft(lines, length * finer) * finer
            place = reach * finer + np.arange(2 * substeps * self.size + 1) * (every * finer / (2 * substeps))
            whole = np.floor(place).astype(np.int64)
            share = place - whole
            if len(self._inputs) > 24:
                self._inputs.clear()
            self._inputs[key] = dense[whole] * (1.0 - share) + dense[whole + 1] * share
        return self._inputs[key]

    def _corrected_spool(self, one: Structure) -> Array:
        """Return the measured spool acceleration without what its channel does to it, m/s^2."""
        own = [one.values[p.name] for part in one.chain if part.channel == "spool" for p in part.parameters]
        key = tuple(own)
        if key not in self._spools:
            row = self._spool[: self.size]
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
        return np.asarray(1.0 + rate * (np.arange(count) + 0.5) * (self.seconds / count))

    def _correction(self, looseness: float) -> Correction:
        """Return the correction of the stationary Kalman filter of the valve as described."""
        if looseness not in self._corrections:
            mass, stiffness = self.valve.moving_mass, self.valve.spring_stiffness
            damping = self.valve.likely_viscous_coefficient
            step = linalg.expm(self.period * np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]]))
            seen = np.array([[-stiffness / mass, -damping / mass]])
            noise = self.readings.noise
            root = math.sqrt(self._every)
            pushed = max(noise.body_rms / root, looseness * float(self.readings.body.std()))
            read = max(noise.spool_rms / root, LEAST_NOISE * float(self._spool.std()))
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

    def _free_over_corrected(self, one: Structure, looseness: float) -> Array:
        """Return the errors of a free run over those of the corrected one, in the mean of each band.

        Over all frequencies the mean of its logarithm is 0 (the filter between both is monic); within the
        band that is compared it is not, and a fit could make errors small by moving them out of the band.
        """
        mass, stiffness, damping = (
            one.values[name] for name in ("mass", "spring_stiffness", "viscous_coefficient")
        )
        correction = self._correction(looseness)
        step = linalg.expm(self.period * np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]]))
        factors = np.array([correction.displacement, correction.velocity])
        if self._every > 1:
            seen = (step[1] - np.array([0.0, 1.0])) / self.period
        else:
            seen, factors = np.array([-stiffness / mass, -damping / mass]), step @ factors
        turn = np.exp(2j * np.pi * self.lines * self.period)
        determinant = (turn - step[0, 0]) * (turn - step[1, 1]) - step[0, 1] * step[1, 0]
        moved = (
            (turn - step[1, 1]) * factors[0] + step[0, 1] * factors[1],
            step[1, 0] * factors[0] + (turn - step[0, 0]) * factors[1],
        )
        ratio = np.log(np.abs(1.0 + (seen[0] * moved[0] + seen[1] * moved[1]) / determinant))
        means = np.add.reduceat(ratio, self._edges[:-1]) / np.diff(self._edges)
        return np.repeat(np.exp(means), np.diff(self._edges))

    # Likelihood -----------------------------------------------------------------------------------------

    def log_likelihood(self, lines: Spectrum) -> float:
        """Return the log likelihood of the errors ``lines`` (windows, lines) but for a constant."""
        levels = self._levels(lines)[1:-1] + self._floor
        return -0.5 * float(np.sum(self._freedom()[1:-1] * np.log(levels)))

    def weights(self, lines: Spectrum) -> Array:
        """Return the root of 1 over the level of each line's tile, shape of ``lines``.

        A tile that happens to be quiet is not trusted more than three times as much as its band.
        """
        levels = self._levels(lines)
        levels = np.maximum(levels, 0.3 * np.median(levels, axis=0, keepdims=True)) + self._floor
        return np.repeat(1.0 / np.sqrt(levels), np.diff(self._edges), axis=1)

    def weighed(self, lines: Spectrum, weights: Array) -> Array:
        """Return ``lines`` times ``weights`` as real numbers, without the first and the last window."""
        inside = lines[1:-1] * weights[1:-1]
        return np.concatenate([inside.real.ravel(), inside.imag.ravel()]) * math.sqrt(2.0)

    def _levels(self, lines: Spectrum) -> Array:
        """Return the mean power of a line in each tile, shape (windows, bands)."""
        power = np.add.reduceat(np.abs(lines) ** 2, self._edges[:-1], axis=1)
        return np.asarray(power / np.diff(self._edges) / np.maximum(self._kept[:, np.newaxis], 0.05))

    def _freedom(self) -> Array:
        """Return how many real numbers each tile holds, shape (windows, bands)."""
        return np.asarray(2.0 * np.diff(self._edges)[np.newaxis, :] * self._kept[:, np.newaxis])

    def _noise_floor(self) -> float:
        """Return the power of a line that rounding stands for."""
        density = self.readings.noise.spool * LEAST_POWER
        return max(density * 0.5 / self.period * float(np.sum(self._taper**2)), 1e-12)


def _edges(lines: Array) -> NDArray[np.int64]:
    """Return where bands begin among ``lines``, evenly in the logarithm, with ``LINES`` lines at least."""
    wanted = np.searchsorted(lines, np.geomspace(lines[0], lines[-1], BANDS + 1))
    edges = [0]
    for place in wanted[1:-1].tolist():
        if place - edges[-1] >= LINES and lines.size - place >= LINES:
            edges.append(place)
    return np.array([*edges, lines.size], dtype=np.int64)


def _certain(velocity: Array) -> Array:
    """Return 0 for samples so near a reversal of ``velocity`` (n,) that their side of it is open, else 1."""
    sign = np.sign(velocity)
    before = np.flatnonzero(sign[1:] * sign[:-1] < 0.0)
    share = velocity[before] / (velocity[before] - velocity[before + 1])
    kept = np.ones(velocity.size)
    kept[before[share < NEAR]] = 0.0
    kept[before[share > 1.0 - NEAR] + 1] = 0.0
    return kept


def _distinct(rows: Sequence[Array]) -> tuple[NDArray[np.int64], Array]:
    """Return the place of each of ``rows`` among those that are different objects, and these."""
    places: dict[int, int] = {}
    numbers = np.array([places.setdefault(id(row), len(places)) for row in rows], dtype=np.int64)
    return numbers, np.array(list({id(row): row for row in rows}.values()))
