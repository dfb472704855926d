"""Residuals of a fit: what they weigh, what they inform of, and the deviations that follow.

Samples next to a jump of the dry friction are left out, a straight line in their place: where in its sample
interval a reversal falls is chance, and the slopes of a sampled jump are spikes. The rest is weighed by the
spectrum of the residual, so that the weighted residual is white whatever sensors, resonance and
excitation make of the noise. Windows fade at both ends: a step there would reach far through the weighing.

Whittle's likelihood of a residual with power density S(f) is a sum of log S over the lines of its spectrum.
For a residual of n independent lines in the band and p parameters

    BIC = n mean(log S) + p log n

up to a constant that all models of one set of data share. For a white residual it is the known n log(rms^2) +
p log n. Every model is judged on all samples in the band, jumps of the friction included.

They hold for noise of any colour and for noise whose strength changes along the record; how far the sensors'
timing is not known, and other doubts, are added.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_core.numbers import Array

from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, FitSettings
from spool_estimator.identification.free_run import FreeRun, Response
from spool_estimator.identification.least_squares import (
    DAMPINGS,
    Descent,
    Unknown,
    Work,
    bounds_of,
    descend,
    sizes_of,
)
from spool_estimator.identification.spectra import Spectrum, ZeroPhase, faded, residual_spectrum

#: s around a jump of the friction that are left out, at least one sample on each side.
JUMP_TIME = 1.5e-4
#: Share of samples that may be left out; where friction jumps more often, nothing is.
MOST_LEFT_OUT = 0.6
#: s over which the differences fade in and out at the ends of a window.
FADE = 0.05
#: Samples around a jump in which a filter before the sampling shows, and the share of power that it adds.
RINGING, RINGS = 5, 0.15
#: Highest frequency that is compared, as a share of the sample rate.
HIGHEST_SHARE = 0.35
#: Relative step of the slopes.
STEP = 1e-3

#: s of the blocks over which the weighted residual's slopes are summed.
BLOCK = 0.5
#: Change of the whole weighted residual by a typical size below which an unknown does not show.
SHOWS = 1e-2


class Weighted(ABC):
    """Weighted residual with its slopes.

    Attributes:
        unknowns: what is fitted, the order of every point.
        values: the numbers that a point does not hold.
    """

    unknowns: tuple[Unknown, ...]
    values: dict[str, float]

    @property
    @abstractmethod
    def work(self) -> Work:
        """Work of the fit so far, and its limit."""

    @property
    @abstractmethod
    def steps(self) -> float:
        """Simulated steps of the residuals at one point."""

    def descend(self, starts: Array, rounds: int, enough: float, tries: int = 1) -> Descent:
        """Return the end of the descents, as :func:`.least_squares.descend`, within the limit of work."""
        # Slopes and trials of each start; known before they begin, so that threads do not matter.
        of_a_round = tries * (len(self.unknowns) + len(DAMPINGS)) * self.steps
        most = self.work.rounds(rounds, of_a_round)
        found = descend(self, starts, most, enough, tries)
        self.work.cut |= most < rounds and not found.converged
        return found

    @abstractmethod
    def residuals(self, points: Array) -> Array:
        """Return the weighted residuals at ``points`` (s, u), shape (s, all samples)."""

    @abstractmethod
    def late(self, point: Array, samples: float) -> Array:
        """Return the weighted residual at ``point`` with the spool's sensor later by ``samples``."""

    @abstractmethod
    def reweigh(self, point: Array) -> None:
        """Leave out jumps and take the weights from the residual at ``point`` (u,)."""

    @property
    @abstractmethod
    def blocks(self) -> list[slice]:
        """Pieces of all samples that hardly depend on each other."""

    def at(self, point: Array) -> Array:
        """Return the weighted residual at ``point`` (u,)."""
        return np.asarray(self.residuals(point[np.newaxis])[0])

    @staticmethod
    def costs(residuals: Array) -> Array:
        """Return the sums of squares of ``residuals`` (s, m), shape (s,); infinite where a run failed."""
        with np.errstate(over="ignore"):
            return np.asarray(np.nan_to_num(np.sum(residuals**2, axis=1), nan=np.inf, posinf=np.inf))

    def at_with_slopes(self, point: Array) -> tuple[Array, Array]:
        """Return ``at`` and its Jacobian, shape (all samples, u); all perturbed sets run in one call."""
        steps = STEP * sizes_of(self.unknowns, point)
        steps = np.where(point + steps > bounds_of(self.unknowns)[1], -steps, steps)
        runs = self.residuals(np.vstack([point, point + np.diag(steps)]))
        broken = ~np.isfinite(runs[1:]).all(axis=1)
        if broken.any():
            steps[broken] *= -1.0
            runs[1:][broken] = self.residuals((point + np.diag(steps))[broken])
        return runs[0], np.asarray(((runs[1:] - runs[0]) / steps[:, np.newaxis]).T)

    def central_slopes(self, point: Array) -> Array:
        """Return the Jacobian by differences to both sides where the bounds leave room."""
        steps = STEP * sizes_of(self.unknowns, point)
        low, high = bounds_of(self.unknowns)
        lows, highs = np.maximum(point - steps, low), np.minimum(point + steps, high)
        runs = self.residuals(np.vstack([point + np.diag(highs - point), point + np.diag(lows - point)]))
        count = len(self.unknowns)
        broken = np.asarray(~np.isfinite(runs).all(axis=1))
        if broken.any():  # one side only
            runs[broken] = self.at(point)
            highs = np.where(broken[:count], point, highs)
            lows = np.where(broken[count:], point, lows)
        return np.asarray(((runs[:count] - runs[count:]) / (highs - lows)[:, np.newaxis]).T)


class Residuals(Weighted):
    """Differences between a model and the records over the windows of a free run.

    Attributes:
        run: the windows.
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
        self._jumps = any(entry.jumps for entry in run.model.terms)

    @property
    def work(self) -> Work:
        """Work of the fit so far, and its limit."""
        return self.run.work

    @property
    def steps(self) -> float:
        """Simulated steps of the residuals at one point."""
        return self.run.steps

    @property
    def has_jumps(self) -> bool:
        """Whether the model has friction that jumps."""
        return self._jumps

    def read_as_means(self) -> None:
        """Compare means over the sample intervals from now on, all of them."""
        self.band_limited = True
        self.kept = [np.ones(kept.size) for kept in self.kept]

    def late(self, point: Array, samples: float) -> Array:
        """Return the weighted residual at ``point`` with the spool's sensor later by ``samples``."""
        delay = samples * self.run.records[0].sample_period
        return np.asarray(self.weighted(self.differences(self.respond(point[np.newaxis], delay)))[0])

    def reweigh(self, point: Array) -> None:
        """Leave out jumps and take the weights from the residual at ``point`` (u,)."""
        responses = self.respond(point[np.newaxis])
        self.leave_jumps_out(responses)
        self.take_spectrum(self.differences(responses))

    @property
    def blocks(self) -> list[slice]:
        """Pieces of all samples, ``BLOCK`` long, that hardly depend on each other."""
        blocks: list[slice] = []
        offset = 0
        for window in self.run.windows:
            size = int(fft.next_fast_len(window.measured.size, real=True))
            length = max(8, round(BLOCK / self.run.records[window.record].sample_period))
            count = max(1, window.measured.size // length)
            edges = offset + size * np.arange(count + 1) // count
            blocks += [
                slice(low, high) for low, high in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
            ]
            offset += size
        return blocks

    def respond(self, points: Array, delay: float = 0.0) -> list[Response]:
        """Return the response at ``points`` (s, u) in each window, the sensor ``delay`` s later still."""
        sets = np.repeat(self.run.sets(self.values), points.shape[0], axis=0)
        gains: Array = np.zeros(points.shape[0])
        delays: Array = np.full(points.shape[0], delay)
        for place, unknown in enumerate(self.unknowns):
            if unknown.name == SPOOL_GAIN:
                gains = points[:, place]
            elif unknown.name == SPOOL_DELAY:
                delays = points[:, place] + delay
            else:
                sets[:, self.run.names.index(unknown.name)] = points[:, place]
        return self.run.responses(sets, gains, delays)

    def differences(self, responses: Sequence[Response]) -> list[Array]:
        """Return model - measured, m/s^2, (s, n) for each window; straight where samples are left out."""
        if self.band_limited:
            return [
                response.means - window.measured_means
                for response, window in zip(responses, self.run.windows, strict=True)
            ]
        return [
            _bridged(response.acceleration - window.measured, kept)
            for response, window, kept in zip(responses, self.run.windows, self.kept, strict=True)
        ]

    def weighted(self, differences: Sequence[Array]) -> Array:
        """Return ``differences`` in the band, weighed to variance 1, shape (s, all samples)."""
        rows = []
        for columns, window in zip(differences, self.run.windows, strict=True):
            count, period = columns.shape[-1], self.run.records[window.record].sample_period
            length = fft.next_fast_len(count, real=True)
            frequency = fft.rfftfreq(length, period)
            gain = ZeroPhase(period, self.band[0], min(self.band[1], HIGHEST_SHARE / period)).gain(frequency)
            spectrum = self.spectrum[window.record]
            if spectrum is not None:
                gain /= np.sqrt(spectrum.at(frequency) * 0.5 / period)
            inside = columns * faded(count, max(1, min(round(FADE / period), count // 4)))
            rows.append(fft.irfft(fft.rfft(inside, length, axis=-1) * gain, length, axis=-1))
        return np.concatenate(rows, axis=-1)

    def residuals(self, points: Array) -> Array:
        """Return the weighted residuals at ``points`` (s, u), shape (s, all samples)."""
        return self.weighted(self.differences(self.respond(points)))

    def leave_jumps_out(self, responses: Sequence[Response]) -> None:
        """Leave out the samples next to jumps of the friction in the first set of ``responses``."""
        if not self._jumps or self.band_limited:
            return
        for number, (response, window) in enumerate(zip(responses, self.run.windows, strict=True)):
            period = self.run.records[window.record].sample_period
            reach = max(1, math.ceil(JUMP_TIME / period))
            near = _within(response.jumps[0].astype(np.float64), reach)
            if near.mean() <= MOST_LEFT_OUT:
                self.kept[number] = np.where(near, 0.0, 1.0)

    def rings(self, responses: Sequence[Response]) -> bool:
        """Return whether the samples around jumps of the friction ring: the record was band-limited first.

        The first set of ``responses`` must fit about. Samples two to six away from a jump are compared with
        those farther off; without a filter before the sampling, both differ from the model alike.
        """
        if not self._jumps:
            return True
        near_power, near_count, far_power, far_count = 0.0, 0, 0.0, 0
        for response, window in zip(responses, self.run.windows, strict=True):
            squares = (response.acceleration[0] - window.measured) ** 2
            jumps = response.jumps[0].astype(np.float64)
            reach = max(1, math.ceil(JUMP_TIME / self.run.records[window.record].sample_period))
            close, wide = _within(jumps, reach), _within(jumps, reach + RINGING)
            near_power += float(squares[wide & ~close].sum())
            near_count += int((wide & ~close).sum())
            far_power += float(squares[~wide].sum())
            far_count += int((~wide).sum())
        if min(near_count, far_count) < 50:
            return True
        ratio = near_power / near_count / (far_power / far_count)
        return ratio > 1.0 + RINGS + 4.0 * math.sqrt(2.0 / min(near_count, far_count))

    def take_spectrum(self, differences: Sequence[Array]) -> None:
        """Weigh from now on by the spectrum of the first set of ``differences``."""
        for record in range(len(self.run.records)):
            rows = [
                columns[0]
                for columns, window in zip(differences, self.run.windows, strict=True)
                if window.record == record
            ]
            if rows:
                self.spectrum[record] = residual_spectrum(rows, self.run.records[record].sample_period)


def information_criterion(residuals: Residuals, point: Array, parameters: int) -> tuple[float, float]:
    """Return BIC at ``point`` and the number of independent samples n that it counts.

    Args:
        residuals: gives windows and band.
        point: fitted values, shape (u,).
        parameters: how many of them the data tell.
    """
    run = residuals.run
    responses = residuals.respond(point[np.newaxis])
    total, count = 0.0, 0.0
    for record, entry in enumerate(run.records):
        rows = [
            response.means[0] - window.measured_means
            for response, window in zip(responses, run.windows, strict=True)
            if window.record == record
        ]
        if not rows:
            continue
        spectrum = residual_spectrum(rows, entry.sample_period)
        high = min(residuals.band[1], HIGHEST_SHARE * entry.sample_rate)
        inside = (spectrum.frequency >= residuals.band[0]) & (spectrum.frequency <= high)
        seconds = sum(row.size for row in rows) * entry.sample_period
        samples = 2.0 * seconds * (high - residuals.band[0])
        total += samples * float(np.mean(np.log(spectrum.density[inside])))
        count += samples
    return total + parameters * math.log(max(count, 2.0)), count


def fit_covariance(
    residuals: Weighted, point: Array, scales: Array, settings: FitSettings, doubts: Sequence[Array] = ()
) -> Array:
    """Return the covariance of the u unknowns at ``point`` (u,), shape (u, u).

    Args:
        residuals: weighed by their spectrum.
        point: where the descent ended.
        scales: typical sizes, shape (u,); an unknown whose typical size hardly shows has infinite variance.
        settings: how well the sensors' timing is known, and whether it was fitted.
        doubts: changes of the point, shape (u,) each, that other readings of the record give.
    """
    residual = residuals.at(point)
    slopes = residuals.central_slopes(point)
    shown = np.linalg.norm(slopes * scales, axis=0) > SHOWS
    covariance = np.diag(np.where(shown, 0.0, math.inf))
    slopes = slopes[:, shown]
    if not shown.any():
        return covariance
    told = covariance_of(slopes, residual, residuals.blocks)
    shifts = [doubt[shown] for doubt in doubts]
    if settings.timing > 0.0 and not settings.fit_delay:
        late = residuals.late(point, settings.timing)
        shifts.append(np.linalg.lstsq(slopes, late - residual, rcond=None)[0])
    for shift in shifts:
        told += np.outer(shift, shift)
    covariance[np.ix_(shown, shown)] = told
    return covariance


def covariance_of(slopes: Array, residual: Array, blocks: Sequence[slice]) -> Array:
    """Return the covariance of a least-squares point, shape (u, u).

    It is that of a weighted residual that is white with variance 1. Where the blocks show more spread (the
    sandwich form; noise whose strength changes along the record, errors of the model), it is as large as they
    show, and a little more where they are few (the variance of Student's t).

    Args:
        slopes: Jacobian, shape (n, u), of full rank.
        residual: at the point, shape (n,), weighed.
        blocks: pieces of the samples that hardly depend on each other.
    """
    bread = np.linalg.inv(slopes.T @ slopes)
    scores = np.array([slopes[block].T @ residual[block] for block in blocks])
    scores -= scores.mean(axis=0)
    count = len(blocks)
    sandwich = bread @ (scores.T @ scores) @ bread * count / max(1, count - slopes.shape[1])
    # Where most of what is known of an unknown comes from: its share in each block.
    shares = np.array([np.sum((slopes[block] @ bread) ** 2, axis=0) for block in blocks])
    worth = shares.sum(axis=0) ** 2 / np.sum(shares**2, axis=0)
    shown_spread = np.diag(sandwich) / np.diag(bread) * (1.0 + 2.0 / worth)
    grown = np.sqrt(np.maximum(1.0, shown_spread))
    return np.asarray(bread * np.outer(grown, grown))


def standard_deviations(covariance: Array) -> Array:
    """Return the square roots of the diagonal, shape (p,); NaN where rounding left no variance."""
    variances = np.diag(covariance)
    return np.asarray(np.sqrt(np.where(variances >= 0.0, variances, np.nan)))


def _within(jumps: Array, reach: int) -> NDArray[np.bool_]:
    """Return which samples stand at most ``reach`` before or after the two around a jump, shape (n,)."""
    near = np.convolve(jumps, np.ones(2 * reach + 2))[reach : reach + jumps.size]
    return np.asarray(near > 0.5)


def _bridged(columns: Array, kept: Array) -> Array:
    """Return ``columns`` (s, n) with straight lines where ``kept`` (n,) is 0."""
    left_out = np.flatnonzero(kept == 0.0)
    if not left_out.size or left_out.size == kept.size:
        return columns
    known = np.flatnonzero(kept)
    place = np.searchsorted(known, left_out)
    after = known[np.minimum(place, known.size - 1)]
    before = known[np.maximum(place - 1, 0)]
    share = (left_out - before) / np.maximum(1, after - before)
    share = np.where(place == 0, 1.0, np.where(place == known.size, 0.0, share))
    columns[:, left_out] = columns[:, before] * (1.0 - share) + columns[:, after] * share
    return columns
