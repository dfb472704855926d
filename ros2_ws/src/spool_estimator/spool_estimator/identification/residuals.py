"""Residuals of a fit: what they weigh, what they inform of, and the deviations that follow.

Samples are weighed by the spectrum of the residual, so that the weighted residual is white whatever sensors,
resonance and excitation make of the noise. Windows fade at both ends: a step there would reach far through
the weighing.

The deviations hold for noise of any colour and for noise whose strength changes along the record; how far the
sensors' timing and the sampling rate are not known is added.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_core.numbers import Array
from spool_core.uncertainty import rate_power
from spool_sim.observation import CAUSAL, INSTANTS, LINEAR, SHAPES, Observation

from spool_estimator.identification import least_squares
from spool_estimator.identification.fit_result import FILTER, SPOOL_DELAY, SPOOL_GAIN, FitSettings
from spool_estimator.identification.free_run import USUAL, FreeRun, Reading, Response
from spool_estimator.identification.least_squares import Unknown
from spool_estimator.identification.spectra import Spectrum, ZeroPhase, faded, residual_spectrum

#: s over which the differences fade in and out at the ends of a window.
FADE = 0.05
#: Highest frequency that is compared, as a share of the sample rate.
HIGHEST_SHARE = 0.45
#: Share of samples at instants that must lie apart from jumps for the others to be left out.
LEAST_KEPT = 0.4

#: s of the blocks over which the weighted residual's slopes are summed.
BLOCK = 0.5
#: Change of the whole weighted residual by a typical size below which an unknown does not show.
SHOWS = 1e-2

CORNER = Unknown(FILTER[0], "1", 0.15, 0.6, 0.1, absolute=True)
ORDER = Unknown(FILTER[1], "1", 1.5, 24.0, 2.0)
BODY_CORNER = Unknown(FILTER[2], "1", 0.1, 1.0, 0.1, absolute=True)
SHAPE = Unknown(FILTER[3], "1", *SHAPES, 0.5, absolute=True)


def filter_unknowns(observation: Observation) -> tuple[Unknown, ...]:
    """Return which numbers of ``observation`` a fit finds."""
    found = {LINEAR: (CORNER, ORDER), CAUSAL: (CORNER,)}.get(observation.kind, ())
    found += () if observation.body_corner is None else (BODY_CORNER,)
    return found if observation.shape is None else (*found, SHAPE)


def filter_numbers(observation: Observation) -> list[float]:
    """Return the values of its ``filter_unknowns``."""
    one = observation
    known = dict(zip(FILTER, (one.corner, one.order, one.body_corner, one.shape), strict=True))
    return [known[one.name] or 0.0 for one in filter_unknowns(observation)]


def with_numbers(
    observation: Observation, unknowns: Sequence[Unknown], point: Sequence[float]
) -> Observation:
    """Return ``observation`` with those of the ``unknowns`` that are its numbers at ``point``, length u."""
    named = {unknown.name: value for unknown, value in zip(unknowns, point, strict=True)}
    return replace(
        observation,
        corner=named.get(CORNER.name, observation.corner),
        order=named.get(ORDER.name, observation.order),
        body_corner=named.get(BODY_CORNER.name, observation.body_corner),
        shape=named.get(SHAPE.name, observation.shape),
    )


class Weighted(least_squares.LeastSquares):
    """Weighted residual of free runs.

    Attributes:
        unknowns: what is fitted, the order of every point.
        values: the numbers that a point does not hold.
    """

    unknowns: tuple[Unknown, ...]
    values: dict[str, float]

    @property
    @abstractmethod
    def work(self) -> least_squares.Work:
        """Work of the fit so far, and its limit."""

    @property
    @abstractmethod
    def steps(self) -> float:
        """Simulated steps of the residuals at one point."""

    def descend(self, starts: Array, rounds: int, enough: float, tries: int = 1) -> least_squares.Descent:
        """Return the end of the descents, as :func:`.least_squares.descend`, within the limit of work."""
        # Slopes and trial of each start; known before they begin, so that threads do not matter.
        of_a_round = tries * (len(self.unknowns) + 1) * self.steps
        most = self.work.rounds(rounds, of_a_round)
        found = least_squares.descend(self, starts, most, enough, tries)
        self.work.cut |= most < rounds and not found.converged
        return found

    @abstractmethod
    def late(self, point: Array, samples: float) -> Array:
        """Return the weighted residual at ``point`` with the spool's sensor later by ``samples``."""

    @abstractmethod
    def delay_by(self, samples: float) -> None:
        """Let the spool's sensor be later by ``samples`` from now on."""

    @abstractmethod
    def reweigh(self, point: Array) -> None:
        """Take the weights from the residual at ``point`` (u,)."""

    @property
    @abstractmethod
    def blocks(self) -> list[slice]:
        """Pieces of all samples that hardly depend on each other."""

    def at(self, point: Array) -> Array:
        """Return the weighted residual at ``point`` (u,)."""
        return np.asarray(self.residuals(point[np.newaxis])[0])

    def costs(self, residuals: Array) -> Array:
        """Return the sums of squares of ``residuals`` (s, m), shape (s,); infinite where a run failed."""
        with np.errstate(over="ignore"):
            return np.asarray(np.nan_to_num(np.sum(residuals**2, axis=1), nan=np.inf, posinf=np.inf))

    def at_with_slopes(self, point: Array) -> tuple[Array, Array]:
        """Return ``at`` and its Jacobian, shape (all samples, u)."""
        residual = self.at(point)
        return residual, np.asarray(self.slopes(point, residual).T)

    def central_slopes(self, point: Array) -> Array:
        """Return the Jacobian by differences to both sides where the bounds leave room."""
        steps = least_squares.STEP * least_squares.sizes_of(self.unknowns, point)
        low, high = least_squares.bounds_of(self.unknowns)
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
        observation: of both channels.
        delay: of the spool's sensor, s, beside what is fitted of it.
        spectrum: of the residual, one for each record, or ``None`` for equal weights.
        kept: weight 0 or 1 of the samples, for each window. Only samples at instants are left out, beside a
            jump: they show on which side of it they are, which has no slope.
    """

    def __init__(
        self,
        run: FreeRun,
        unknowns: Sequence[Unknown],
        values: Mapping[str, float],
        band: tuple[float, float],
    ) -> None:
        """Start with equal weights and the usual observation; ``band`` in Hz."""
        self.run = run
        self.unknowns = tuple(unknowns)
        self.values = dict(values)
        self.band = band
        self.observation = USUAL
        self.delay = 0.0
        self.spectrum: list[Spectrum | None] = [None] * len(run.records)
        self.kept: list[Array] = [np.ones(1)] * len(run.windows)

    @property
    def work(self) -> least_squares.Work:
        """Work of the fit so far, and its limit."""
        return self.run.work

    @property
    def steps(self) -> float:
        """Simulated steps of the residuals at one point."""
        return self.run.steps

    def late(self, point: Array, samples: float) -> Array:
        """Return the weighted residual at ``point`` with the spool's sensor later by ``samples``."""
        delay = samples * self.run.records[0].sample_period
        return np.asarray(self.weighted(self.differences(self.respond(point[np.newaxis], delay)))[0])

    def delay_by(self, samples: float) -> None:
        """Let the spool's sensor be later by ``samples`` from now on."""
        self.delay += samples * self.run.records[0].sample_period

    def reweigh(self, point: Array) -> None:
        """Take the weights from the residual at ``point`` (u,)."""
        self.leave_out(point)
        self.take_spectrum(self.differences(self.respond(point[np.newaxis])))

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
            blocks += [slice(low, high) for low, high in pairwise(edges.tolist())]
            offset += size
        return blocks

    def respond(self, points: Array, delay: float = 0.0) -> list[Response]:
        """Return the response at ``points`` (s, u) in each window, the sensor ``delay`` s later still."""
        sets = np.repeat(self.run.sets(self.values), points.shape[0], axis=0)
        readings = []
        for row in points.tolist():
            named = {unknown.name: value for unknown, value in zip(self.unknowns, row, strict=True)}
            gain, late = named.get(SPOOL_GAIN, 0.0), named.get(SPOOL_DELAY, 0.0) + delay + self.delay
            readings.append(Reading(gain, late, with_numbers(self.observation, self.unknowns, row)))
        for place, unknown in enumerate(self.unknowns):
            if unknown.name in self.run.names:
                sets[:, self.run.names.index(unknown.name)] = points[:, place]
        return self.run.responses(sets, readings)

    def differences(self, responses: Sequence[Response]) -> list[Array]:
        """Return model - measured, m/s^2, (s, n) for each window, 0 where a sample is left out."""
        return [
            (response.acceleration - window.measured) * kept
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

    @np.errstate(invalid="ignore")  # a motion that diverges leaves nothing finite
    def residuals(self, points: Array) -> Array:
        """Return the weighted residuals at ``points`` (s, u), shape (s, all samples)."""
        return self.weighted(self.differences(self.respond(points)))

    def leave_out(self, point: Array) -> None:
        """Leave out which samples at instants stand beside a jump at ``point`` (u,)."""
        if self.observation.kind == INSTANTS:
            self.kept = [apart(response).astype(np.float64) for response in self.respond(point[np.newaxis])]

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


def read_as(residuals: Residuals, observation: Observation) -> Residuals:
    """Return ``residuals`` of equal weights under ``observation``, whose numbers become unknowns."""
    other = Residuals(
        residuals.run, (*residuals.unknowns, *filter_unknowns(observation)), residuals.values, residuals.band
    )
    other.observation = observation
    return other


def information_criterion(residuals: Residuals, point: Array, parameters: int) -> tuple[float, float]:
    """Return BIC at ``point`` and the number of independent samples n that it counts.

    Whittle's likelihood of a residual with power density S(f) is a sum of log S over the lines of its
    spectrum. For a residual of n independent lines in the band and p parameters

        BIC = n mean(log S) + p log n

    up to a constant that all models of one set of data share. For a white residual it is the known
    n log(rms^2) + p log n.

    Args:
        residuals: gives windows and band.
        point: fitted values, shape (u,).
        parameters: how many of them the data tell.
    """
    run = residuals.run
    differences = residuals.differences(residuals.respond(point[np.newaxis]))
    total, count = 0.0, 0.0
    for record, entry in enumerate(run.records):
        rows = [
            columns[0]
            for columns, window in zip(differences, run.windows, strict=True)
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
    residuals: Weighted, point: Array, scales: Array, settings: FitSettings, rate_std: float = 0.0
) -> tuple[Array, Array]:
    """Return the end of a fit and the covariance of its u unknowns, shapes (u,) and (u, u).

    ``residuals`` take the delay that belongs to it.

    The time between both channels is an unknown as well: the records tell it, and how well it is known
    beforehand (``settings.timing``).

    Args:
        residuals: weighed by their spectrum.
        point: where the descent ended, shape (u,).
        scales: typical sizes, shape (u,); an unknown whose typical size hardly shows has infinite variance.
        settings: how well the sensors' timing is known, and whether it was fitted.
        rate_std: relative standard deviation of the sampling rate.
    """
    residual, slopes = residuals.at_with_slopes(point)
    shown = np.linalg.norm(slopes * scales, axis=0) > SHOWS
    covariance = np.diag(np.where(shown, 0.0, math.inf))
    slopes = slopes[:, shown]
    if not shown.any():
        return point, covariance
    own, moved = np.arange(slopes.shape[1]), point.copy()
    if settings.timing > 0.0 and not settings.fit_delay:
        late = residuals.late(point, settings.timing) - residual
        # In units of its standard deviation, which is the last row.
        slopes = np.vstack([np.column_stack([slopes, late]), np.eye(1, own.size + 1, own.size)])
        step = np.linalg.lstsq(slopes, np.append(residual, 0.0), rcond=None)[0]
        moved[shown] -= step[own]
        residuals.delay_by(-float(step[-1]) * settings.timing)
    told = covariance_of(slopes, residual, residuals.blocks)[0][np.ix_(own, own)]
    if rate_std > 0.0:
        powers = np.array([rate_power(unknown.unit) for unknown in residuals.unknowns])
        doubt = (rate_std * powers * point)[shown]
        told += np.outer(doubt, doubt)
    covariance[np.ix_(shown, shown)] = told
    return moved, covariance


def covariance_of(
    slopes: Array, residual: Array, blocks: Sequence[slice | NDArray[np.int64]]
) -> tuple[Array, float]:
    """Return the covariance of a least-squares point, shape (u, u), and the dispersion, 1 at least.

    It is that of a weighted residual that is white with variance 1. Errors that go with the motion, as those
    of a noisy input or of a law that is a little wrong, repeat, and noise may change along the record: where
    the blocks show more spread (the sandwich form), it is as large as they show, and a little more where they
    are few (the variance of Student's t). The dispersion is how many times larger, in power, over all.

    Sources: Huber, 1967; White, 1982 (sandwich).

    Args:
        slopes: Jacobian, shape (n, u); rows that no block holds are priors.
        residual: at the point, weighed, shape (n,) or shorter by the priors.
        blocks: pieces of the samples that hardly depend on each other.
    """
    information = slopes.T @ slopes
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    bread = np.linalg.pinv(information / np.outer(size, size), hermitian=True) / np.outer(size, size)
    scores = np.array([slopes[block].T @ residual[block] for block in blocks])
    scores -= scores.mean(axis=0)
    count = len(blocks)
    meat = scores.T @ scores * (count / max(1, count - slopes.shape[1]))
    # Where most of what is known of an unknown comes from: its share in each block.
    shares = np.array([np.sum((slopes[block] @ bread) ** 2, axis=0) for block in blocks])
    worth = shares.sum(axis=0) ** 2 / np.maximum(np.sum(shares**2, axis=0), 1e-300)
    alone = np.maximum(np.diag(bread), 1e-300)
    shown_spread = np.diag(bread @ meat @ bread) / alone * (1.0 + 2.0 / np.maximum(worth, 1.0))
    grown = np.sqrt(np.maximum(1.0, shown_spread))
    dispersion = max(1.0, float(np.sum(bread * meat)) / len(bread))
    return np.asarray(bread * np.outer(grown, grown)), dispersion


def standard_deviations(covariance: Array) -> Array:
    """Return the square roots of the diagonal, shape (p,); NaN where rounding left no variance."""
    variances = np.diag(covariance)
    return np.asarray(np.sqrt(np.where(variances >= 0.0, variances, np.nan)))


def apart(response: Response) -> NDArray[np.bool_]:
    """Return which samples stand beside no jump, shape (n,); all where too few would be left."""
    size = response.acceleration.shape[1]
    kept = np.ones(size, dtype=np.bool_)
    beside = np.floor(response.jumps).astype(np.int64)[:, np.newaxis] + np.arange(2)
    kept[beside[(beside >= 0) & (beside < size)]] = False
    return kept if kept.mean() > LEAST_KEPT else np.ones(size, dtype=np.bool_)
