"""Errors in variables: what the noise of the body's sensor, the excitation, does to a least-squares point.

Noise in the excitation shakes dry friction loose and multiplies with itself in the normal equations: both
bend the parameters by a little that does not average out. It is found by simulation: the model at the point
makes a record, the excitation gets more of the same noise, once added and once taken away, so that what is
odd in the noise cancels, and one step of the descent shows where the point goes (as SIMEX does, Cook and
Stefanski 1994, J. Am. Stat. Assoc. 89).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from spool_estimator.identification.signals.channel_noise import noise_of

from .free_run import FALL, FreeRun, Response, excitation_limit
from .record import Record
from .residuals import HIGHEST_SHARE, Residuals
from .uncertainty import standard_deviations

Array = NDArray[np.float64]

#: Pairs of noise, added and taken away.
PAIRS = 6
#: Standard deviations up to which a bias is believed.
BELIEVED = 3.0


@dataclass(frozen=True, slots=True)
class NoiseEffect:
    """By how much the noise of the excitation moves the u unknowns.

    Attributes:
        bias: on the average, shape (u,).
        covariance: from one noise to another, shape (u, u).
        uncertainty: standard deviation of ``bias``, shape (u,).
    """

    bias: Array
    covariance: Array
    uncertainty: Array

    def taken_off(self, point: Array, covariance: Array) -> tuple[Array, Array]:
        """Return ``point`` (u,) and its ``covariance`` (u, u) without the bias, with what is unsure of it.

        Half of the bias stays in the covariance, all of it where it is too large for one step to be right.
        """
        seen = np.maximum(1.0, np.diag(self.covariance) / np.diag(covariance))
        grown = covariance * np.sqrt(np.outer(seen, seen))
        believed = np.abs(self.bias) < BELIEVED * standard_deviations(grown)
        unsure = np.where(believed, 0.5, 1.0) * self.bias
        moved = point - np.where(believed, self.bias, 0.0)
        return moved, np.asarray(grown + np.outer(unsure, unsure) + np.diag(self.uncertainty**2))


def noise_density(record: Record, highest: float) -> float:
    """Return the one-sided power density, (m/s^2)^2/Hz, of the body's noise above the excitation.

    0 where the excitation, up to ``highest`` (Hz), leaves no band to see it in.
    """
    if FALL * highest >= HIGHEST_SHARE * record.sample_rate:
        return 0.0
    return noise_of(record.body, record.spool, record.sample_rate).body


def input_noise_effect(
    residuals: Residuals, point: Array, shown: NDArray[np.bool_], seconds: float
) -> NoiseEffect | None:
    """Return what the excitation's noise does to the ``shown`` unknowns at ``point``; ``None`` without noise.

    It is looked at on ``seconds`` of data at most.

    The noise is drawn from a fixed seed, so that the same records give the same result.
    """
    run = residuals.run.fewer(seconds)
    densities = [noise_density(entry, excitation_limit(entry)) for entry in run.records]
    if not any(densities):
        return None
    made = _over(residuals, run).respond(point[np.newaxis])
    generator = np.random.default_rng(0)
    steps = []
    for _ in range(PAIRS):
        noises = [_noise(run, number, densities, generator) for number in range(len(run.windows))]
        pair = []
        for sign in (1.0, -1.0):
            shaken = _over(residuals, _shaken(run, made, noises, sign))
            shaken.leave_jumps_out(shaken.respond(point[np.newaxis]))
            error, slopes = shaken.at_with_slopes(point)
            pair.append(-np.linalg.lstsq(slopes[:, shown], error, rcond=None)[0])
        steps.append(pair)
    moves = np.array(steps)
    even, odd = moves.mean(axis=1), 0.5 * (moves[:, 0] - moves[:, 1])
    share = sum(w.stop - w.start for w in run.windows) / sum(w.stop - w.start for w in residuals.run.windows)
    return NoiseEffect(
        even.mean(axis=0), odd.T @ odd / PAIRS * share, even.std(axis=0, ddof=1) / np.sqrt(PAIRS)
    )


def _over(residuals: Residuals, run: FreeRun) -> Residuals:
    """Return the same weights over the windows of ``run``, whose samples all count."""
    other = copy.copy(residuals)
    other.run = run
    other.kept = [np.ones(window.measured.size) for window in run.windows]
    return other


def _noise(
    run: FreeRun, number: int, densities: Sequence[float], generator: np.random.Generator
) -> NDArray[np.complex128]:
    """Return the spectrum of white noise of the body's strength where the excitation has its band."""
    window = run.windows[number]
    period = run.records[window.record].sample_period
    highest = run.highest_frequency[window.record]
    level = np.sqrt(0.5 * densities[window.record] / period)
    spectrum = fft.rfft(generator.normal(0.0, level, window.length))
    share = np.clip((fft.rfftfreq(window.length, period) / highest - 1.0) / (FALL - 1.0), 0.0, 1.0)
    return np.asarray(spectrum * (0.5 + 0.5 * np.cos(np.pi * share)))


def _shaken(
    run: FreeRun, made: Sequence[Response], noises: Sequence[NDArray[np.complex128]], sign: float
) -> FreeRun:
    """Return the windows as if ``made`` had been measured, and the excitation with the noise added."""
    return run.driven_by(
        [
            replace(
                window,
                excitation=window.excitation + sign * noise,
                measured=response.acceleration[0],
                measured_means=response.means[0],
            )
            for window, response, noise in zip(run.windows, made, noises, strict=True)
        ]
    )
