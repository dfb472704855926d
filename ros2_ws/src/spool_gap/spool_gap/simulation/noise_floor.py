"""Noise floor: what noise alone would leave of a model that is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_estimator.identification.spectra import ZeroPhase, floor_of, interval_mean_response

from .point import Point
from .shooting import Piece
from .simulate import Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Floor:
    """Noise that remains.

    Attributes:
        nrmse: over rms(measured), held out.
        errors: one draw of it for each held-out window, m/s^2, shape (1, n).
        spool: one-sided density of the spool channel's noise of each stretch, (m/s^2)^2/Hz.
    """

    nrmse: float
    errors: Sequence[Array]
    spool: list[float]


def noise_floor(simulation: Simulation, point: Point, errors: Sequence[Array], seed: int = 0) -> Floor:
    """Return the noise floor of ``point``: simulated again with the body's noise, plus the spool's noise.

    Args:
        simulation: the windows.
        point: the accepted hypothesis.
        errors: what it leaves on the held-out windows.
        seed: of the noise.
    """
    held = simulation.held_out
    spool = []
    for stretch, (frequency, density) in zip(
        simulation.stretches, simulation.spectra(errors, held), strict=True
    ):
        left = stretch.noise.spool
        if density.size > 8:
            left = floor_of(density / response_of(simulation, frequency, stretch.record.sample_period))
        spool.append(min(stretch.noise.spool, left))
    generator = np.random.default_rng(seed)
    clean = simulation.errors([point], held)
    places = list(simulation.places)
    noises = {
        id(stretch): stretch.quiet.apply(
            generator.normal(0.0, stretch.noise.body_rms, stretch.record.body.size)
        )
        for stretch in simulation.stretches
    }
    for number in held:
        stretch, window, training = places[number]
        noise = noises[id(stretch)]
        place = window.first - window.margin + np.arange(window.length)
        inside = (place >= 0) & (place < noise.size)
        lines = np.fft.rfft(np.where(inside, noise[np.clip(place, 0, noise.size - 1)], 0.0))
        window = replace(window, excitation=window.excitation + lines)
        if isinstance(window, Piece) and any(window.wander):
            off = generator.normal(0.0, window.wander)
            window = replace(window, state=(window.state[0] + off[0], window.state[1] + off[1]))
        places[number] = (stretch, window, training)
    noisy = simulation.over(places).errors([point], held)
    total = []
    for number, one, other in zip(held, clean, noisy, strict=True):
        stretch, window, _ = simulation.places[number]
        index = [s is stretch for s in simulation.stretches].index(True)
        sigma = float(np.sqrt(spool[index] * 0.5 * stretch.noise.rate))
        mask = stretch.kept[window.start : window.stop]
        if simulation.jumps is not None:
            mask = mask * simulation.jumps[number]
        white = generator.normal(0.0, sigma, one.shape[-1] + 1)
        if simulation.jumps is None:
            white = ZeroPhase(stretch.record.sample_period, 0.0).apply(white, interval_means=True)
        total.append((other - one) + mask * white[:-1])
    return Floor(float(simulation.nrmse(total, held)[0]), total, spool)


def response_of(simulation: Simulation, frequency: Array, period: float) -> Array:
    """Return what the compared quantity keeps of the power of white noise, at least 0.2."""
    if simulation.jumps is not None:
        return np.ones(frequency.size)
    return np.asarray(np.maximum(np.abs(interval_mean_response(frequency, period)) ** 2, 0.2))


def excess(simulation: Simulation, errors: Sequence[Array], floor: Floor) -> float:
    """Return the held-out residual's power over the noise floor's, up to three times the excited band."""
    held = simulation.held_out
    ratios, weights = [], []
    left = simulation.spectra(errors, held)
    noise = simulation.spectra(floor.errors, held)
    for stretch, (frequency, density), (_, expected) in zip(simulation.stretches, left, noise, strict=True):
        band = (frequency > stretch.low_cut) & (
            frequency < min(3.0 * stretch.noise.high, 0.4 * stretch.noise.rate)
        )
        if band.any() and expected[band].min() > 0.0:
            ratios.append(float(np.mean(density[band] / expected[band])))
            weights.append(float(band.sum()))
    return float(np.average(ratios, weights=weights)) if ratios else 1.0
