"""Sampling jitter: noise that grows with the slope of the reading.

A reading taken too early or too late is off by slope times time. That is noise to any model, so it hides in
the noise floor; what gives it away is that it comes and goes with the slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.optimize import minimize

from spool_gap.thresholds import THRESHOLDS

from .noise_floor import response_of
from .simulate import Simulation

Array = NDArray[np.float64]

#: Lower end of the band that is looked at over the excitation's upper end; upper end over the sample rate.
ABOVE, UPPER = 2.0, 0.45
#: Share of that band in all frequencies below which nothing is said.
NARROWEST = 0.15


@dataclass(frozen=True, slots=True)
class Jitter:
    """Scatter of the sampling instants.

    Attributes:
        deviation: standard deviation of the instants, s.
        share: of the noise above the excitation's band that grows with the slope.
        evidence: twice the log likelihood ratio against noise that does not.
    """

    deviation: float
    share: float
    evidence: float

    @property
    def tells(self) -> bool:
        """Whether the instants scatter."""
        return self.evidence > THRESHOLDS.jitter_evidence and self.share > THRESHOLDS.jitter_share

    @property
    def sentence(self) -> str:
        """What that is on the machine."""
        return (
            "the noise of the spool's channel grows with the slope of the reading, as where samples are "
            f"taken {1e3 * self.deviation:.2g} ms (rms) too early or too late: check the clock that "
            "takes them"
        )


def sampling_jitter(simulation: Simulation, errors: list[Array], chosen: list[int]) -> Jitter | None:
    """Return the jitter of the spool's channel; ``None`` where the excitation leaves no band to see it in.

    Args:
        simulation: the windows.
        errors: model - measured of those ``chosen``, m/s^2, shape (1, n) each.
        chosen: numbers of the windows.
    """
    squares, slopes, shares, kept = [], [], [], []
    for error, place, measured in zip(errors, chosen, simulation.measured(chosen), strict=True):
        stretch, window, _ = simulation.places[place]
        rate = stretch.noise.rate
        lines = fft.rfftfreq(error.shape[-1], 1.0 / rate)
        band = (lines > max(ABOVE * stretch.noise.high, 0.1 * rate)) & (lines < UPPER * rate)
        if band.mean() < NARROWEST:
            continue
        left = fft.irfft(fft.rfft(error[0]) * band, error.shape[-1])
        slope = np.gradient(error[0] + measured) * rate
        inside = stretch.kept[window.start : window.stop] > 0.5
        inside[: inside.size // 20] = inside[-(inside.size // 20) :] = False
        squares.append(left[inside] ** 2)
        slopes.append(slope[inside] ** 2)
        shares.append(float(band.mean()))
        kept.append(float(np.mean(band * response_of(simulation, lines, 1.0 / rate))))
    if not squares:
        return None
    square, slope = np.concatenate(squares), np.concatenate(slopes)
    whole, steepest = float(square.mean()), float(slope.mean())
    if whole <= 0.0 or steepest <= 0.0:
        return None
    square, slope = square / whole, slope / steepest

    def unlikely(parts: Array) -> float:
        power = np.exp(parts[0]) + np.exp(parts[1]) * slope
        return float(np.sum(np.log(power) + square / power))

    found = minimize(unlikely, np.log([0.5, 0.5]), method="Nelder-Mead")
    constant, growing = np.exp(found.x)
    # Samples of a band that is a part of all frequencies say as much as that part of them.
    evidence = float(np.mean(shares)) * (square.size - float(found.fun))
    deviation = float(np.sqrt(growing * whole / steepest / np.mean(kept)))
    return Jitter(deviation, float(growing / (constant + growing)), evidence)
