"""Weighted differences of a free run and the record, and their slopes, as least squares takes them.

Samples next to a jump of the dry friction are left out: where in its sample interval a reversal falls is
chance, and the slopes of a sampled jump are spikes. The rest is weighed by the spectrum of what is left over,
so that the weighted residual is white whatever sensors, resonance and drive make of the noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from .fit_result import SPOOL_DELAY, SPOOL_GAIN
from .free_run import FreeRun, Response
from .zero_phase import ZeroPhase

Array = NDArray[np.float64]

#: s around a jump of the friction that are left out, at least one sample on each side.
JUMP_TIME = 1.5e-4
#: Share of samples that may be left out; where friction jumps more often, nothing is.
MOST_LEFT_OUT = 0.6
#: s of the pieces that the residual's spectrum is averaged over.
SPECTRUM_PIECE = 0.5
#: Highest frequency that is compared, as a share of the sample rate.
HIGHEST_SHARE = 0.35
#: Relative step of the slopes.
STEP = 1e-3


@dataclass(frozen=True, slots=True)
class Unknown:
    """A fitted number: its name, unit, bounds and a typical size."""

    name: str
    unit: str
    low: float
    high: float
    scale: float


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density of the residual, (m/s^2)^2/Hz, at ``frequency`` (Hz), both shape (f,)."""

    frequency: Array
    density: Array

    def at(self, frequency: Array) -> Array:
        """Return the density at ``frequency``, same shape."""
        return np.interp(frequency, self.frequency, self.density)


class Residuals:
    """Residuals of a model over the windows of a free run.

    Attributes:
        run: the windows.
        unknowns: what is fitted, the order of every point.
        values: the model's parameters that a point does not hold.
        band_limited: compare means over the sample intervals, not samples.
        kept: weight 0 or 1 of each sample, one array for each window.
        spectrum: of the residual, one for each record, or ``None`` for equal weights.
    """

    def __init__(
        self,
        run: FreeRun,
        unknowns: Sequence[Unknown],
        values: Mapping[str, float],
        band: tuple[float, float],
    ) -> None:
        """Start with equal weights and every sample kept; ``band`` in Hz."""
        self.run = run
        self.unknowns = tuple(unknowns)
        self.values = dict(values)
        self.band = band
        self.band_limited = True
        self.kept: list[Array] = [np.ones(window.measured.size) for window in run.windows]
        self.spectrum: list[Spectrum | None] = [None] * len(run.records)
        laws = {law for entry in run.model.terms for law in entry.laws}
        self._jumps = bool(laws & {"sliding_law", "memory_law"})

    def respond(self, points: Array) -> list[Response]:
        """Return the response at ``points`` (s, u) in each window."""
        sets = np.repeat(self.run.sets(self.values), points.shape[0], axis=0)
        gains: Array = np.zeros(points.shape[0])
        delays: Array = np.zeros(points.shape[0])
        for place, unknown in enumerate(self.unknowns):
            if unknown.name == SPOOL_GAIN:
                gains = points[:, place]
            elif unknown.name == SPOOL_DELAY:
                delays = points[:, place]
            else:
                sets[:, self.run.names.index(unknown.name)] = points[:, place]
        return self.run.responses(sets, gains, delays)

    def differences(self, responses: Sequence[Response]) -> list[Array]:
        """Return model - measured where samples are kept, m/s^2, shape (s, n) for each window."""
        if self.band_limited:
            return [
                response.means - window.measured_means
                for response, window in zip(responses, self.run.windows, strict=True)
            ]
        return [
            (response.acceleration - window.measured) * kept
            for response, window, kept in zip(responses, self.run.windows, self.kept, strict=True)
        ]

    def weighted(self, differences: Sequence[Array]) -> Array:
        """Return ``differences`` in the band, weighed to variance 1, shape (s, all samples)."""
        return np.concatenate(
            [
                self._weigh(columns, window.record)
                for columns, window in zip(differences, self.run.windows, strict=True)
            ],
            axis=-1,
        )

    def _weigh(self, columns: Array, record: int) -> Array:
        period = self.run.records[record].sample_period
        length = fft.next_fast_len(columns.shape[-1], real=True)
        frequency = fft.rfftfreq(length, period)
        gain = ZeroPhase(period, self.band[0], min(self.band[1], HIGHEST_SHARE / period)).gain(frequency)
        spectrum = self.spectrum[record]
        if spectrum is not None:
            gain /= np.sqrt(spectrum.at(frequency) * 0.5 / period)
        return np.asarray(fft.irfft(fft.rfft(columns, length, axis=-1) * gain, length, axis=-1))

    def at(self, point: Array) -> Array:
        """Return the weighted residual at ``point`` (u,)."""
        return np.asarray(self.weighted(self.differences(self.respond(point[np.newaxis])))[0])

    def steps(self, point: Array) -> Array:
        """Return the steps of the slopes at ``point``, shape (u,), towards the inside of the bounds."""
        steps = np.array(
            [
                STEP * max(abs(value), 0.1 * unknown.scale)
                for value, unknown in zip(point.tolist(), self.unknowns, strict=True)
            ]
        )
        beyond = point + steps > [unknown.high for unknown in self.unknowns]
        return np.where(beyond, -steps, steps)

    def slopes(self, point: Array) -> Array:
        """Return the Jacobian of ``at``, shape (all samples, u); all perturbed sets run in one call."""
        steps = self.steps(point)
        points = np.vstack([point, point + np.diag(steps)])
        runs = self.weighted(self.differences(self.respond(points)))
        return np.asarray(((runs[1:] - runs[0]) / steps[:, np.newaxis]).T)

    def central_slopes(self, point: Array) -> Array:
        """Return the Jacobian by differences to both sides where the bounds leave room."""
        steps = np.abs(self.steps(point))
        lows = np.maximum(point - steps, [unknown.low for unknown in self.unknowns])
        highs = np.minimum(point + steps, [unknown.high for unknown in self.unknowns])
        changes = np.diag(highs - point), np.diag(lows - point)
        runs = self.weighted(
            self.differences(self.respond(np.vstack([point + change for change in changes])))
        )
        count = len(self.unknowns)
        return np.asarray(((runs[:count] - runs[count:]) / (highs - lows)[:, np.newaxis]).T)

    def leave_jumps_out(self, responses: Sequence[Response]) -> None:
        """Leave out the samples next to jumps of the friction in the first set of ``responses``."""
        if not self._jumps or self.band_limited:
            return
        for number, (response, window) in enumerate(zip(responses, self.run.windows, strict=True)):
            period = self.run.records[window.record].sample_period
            reach = max(1, math.ceil(JUMP_TIME / period))
            jumps = response.jumps[0].astype(np.float64)
            # The sample before a jump and the one after it, each with its neighbours.
            near = np.convolve(jumps, np.ones(2 * reach + 2))[reach : reach + jumps.size] > 0.0
            if near.mean() <= MOST_LEFT_OUT:
                self.kept[number] = np.where(near, 0.0, 1.0)

    def choose_sampling(self, responses: Sequence[Response]) -> None:
        """Compare samples or means over sample intervals, whichever fit the first set of ``responses``.

        Records that were band-limited before they were sampled have the jumps of friction smeared over some
        samples: their means agree. Records that were not have the jumps where they are, and means between
        samples are not known: samples agree, but for those next to a jump.
        """
        if not self._jumps:
            return
        self.band_limited = False
        self.leave_jumps_out(responses)
        sizes = []
        for band_limited in (True, False):
            self.band_limited = band_limited
            errors = self.differences(responses)
            count = sum(
                error.shape[-1] if band_limited else kept.sum()
                for error, kept in zip(errors, self.kept, strict=True)
            )
            weighted = self.weighted([error[:1] for error in errors])
            sizes.append(float(np.sum(weighted**2)) / float(count))
        self.band_limited = sizes[0] <= sizes[1]
        if self.band_limited:
            self.kept = [np.ones(kept.size) for kept in self.kept]

    def take_spectrum(self, differences: Sequence[Array]) -> None:
        """Weigh from now on by the spectrum of the first set of ``differences``."""
        for record in range(len(self.run.records)):
            rows = [
                (columns[0], kept)
                for columns, kept, window in zip(differences, self.kept, self.run.windows, strict=True)
                if window.record == record
            ]
            if rows:
                self.spectrum[record] = residual_spectrum(rows, self.run.records[record].sample_period)


def residual_spectrum(rows: Sequence[tuple[Array, Array]], sample_period: float) -> Spectrum:
    """Return the smoothed spectrum of residuals with samples left out.

    Args:
        rows: residual and weight (0 or 1) of each window, shapes (n,).
        sample_period: s.
    """
    shortest = min(residual.size for residual, _ in rows)
    piece = min(shortest, max(16, round(SPECTRUM_PIECE / sample_period)))
    densities, weights = [], []
    for residual, kept in rows:
        frequency, density = signal.welch(
            residual, 1.0 / sample_period, "hann", piece, detrend=False, scaling="density"
        )
        densities.append(density)
        weights.append(residual.size)
        share = max(0.05, float(kept.mean()))
        densities[-1] = density / share
    mean = np.average(densities, axis=0, weights=weights)
    # A tenth of the frequency, at least two lines: noise is smooth, and weights must not follow chance.
    half = np.maximum(2, (0.05 * np.arange(mean.size)).astype(np.int64))
    total = np.concatenate([[0.0], np.cumsum(mean)])
    low = np.maximum(0, np.arange(mean.size) - half)
    high = np.minimum(mean.size, np.arange(mean.size) + half + 1)
    smooth = (total[high] - total[low]) / (high - low)
    floor = 1e-6 * float(smooth.max()) + 1e-30
    return Spectrum(np.asarray(frequency), np.maximum(smooth, floor))
