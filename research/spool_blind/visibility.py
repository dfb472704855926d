"""Visibility of what is hidden: what remains of it after the base has taken what it can.

The base is mass, spring and viscous drag with a gain and a delay of the spool's channel inside the declared
tolerances. It is fitted to the record without noise; what remains is weighed with the spectrum that noise of
both channels leaves in the difference of measurement and free run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq
from scipy.optimize import least_squares
from scipy.stats import chi2, ncx2

from spool_blind.condition import DELAY_TOLERANCE, GAIN_TOLERANCE
from spool_blind.simulator import Padded, transmissibility

Array = NDArray[np.float64]

#: Rate of false alarms, and power at the threshold: half of the records.
FALSE_ALARM, POWER = 0.01, 0.5


@dataclass(frozen=True, slots=True)
class Visibility:
    """How much of what is hidden remains.

    Attributes:
        nrmse: rms of the remainder over that of the spool's acceleration; the gap, without noise.
        noise_nrmse: the same measure of the noise alone: the floor.
        evidence: noncentrality of a likelihood-ratio test that knows what is hidden and refits the base.
        base: stiffness (N/m), damping (N s/m), gain and delay (s) that leave least.
    """

    nrmse: float
    noise_nrmse: float
    evidence: float
    base: Mapping[str, float]

    @property
    def over_noise(self) -> float:
        """The remainder over the noise floor, both rms."""
        return self.nrmse / self.noise_nrmse


def threshold(parameters: int) -> float:
    """Return the evidence at which a test for ``parameters`` numbers sees half of the records.

    The test raises one false alarm in a hundred records.
    """
    critical = float(chi2.ppf(1.0 - FALSE_ALARM, parameters))
    low, high = 0.0, 10.0 * critical
    for _ in range(60):
        middle = 0.5 * (low + high)
        if ncx2.sf(critical, parameters, middle) < POWER:
            low = middle
        else:
            high = middle
    return high


def look(
    start: Mapping[str, float],
    body: Array,
    spool: Array,
    rate: float,
    *,
    first: int,
    noise: float,
    tolerance: float = 1.0,
) -> Visibility:
    """Return what remains in ``spool`` after the base has been fitted.

    Args:
        start: mass (kept), stiffness and damping of a plant to start from, SI.
        body: acceleration of the body from its rise from rest on, without noise, m/s^2, shape (first + n,).
        spool: reading of the spool's channel, without noise, m/s^2, shape (n,).
        rate: Hz.
        first: samples of ``body`` ahead of the record.
        noise: rms of white noise in either channel, m/s^2.
        tolerance: gain and delay may be off by so many times what is declared.
    """
    padded = Padded(body, rate)
    rms = float(spool.std())

    def factor(x: Array) -> NDArray[np.complex128]:
        numbers = {
            "mass": start["mass"],
            "stiffness": start["stiffness"] * np.exp(x[0]),
            "damping": start["damping"] * np.exp(x[1]),
        }
        turn = -2j * np.pi * padded.frequency * x[3] * DELAY_TOLERANCE
        gain = 1.0 + x[2] * GAIN_TOLERANCE
        return np.asarray(transmissibility(numbers, padded.frequency) * gain * np.exp(turn))

    def remainder(x: Array) -> Array:
        return np.asarray((padded.through(factor(x))[first:] - spool) / rms)

    found = least_squares(
        remainder,
        np.zeros(4),
        bounds=([-1.5, -3.0, -tolerance, -tolerance], [1.5, 3.0, tolerance, tolerance]),
        x_scale=[0.01, 0.1, 1.0, 1.0],
        xtol=1e-7,
        ftol=1e-9,
        max_nfev=25,
    )
    left = remainder(found.x) * rms
    window = np.hanning(left.size)
    window /= np.sqrt(np.mean(window**2))
    frequency = rfftfreq(left.size, 1.0 / rate)
    through = np.interp(frequency, padded.frequency, np.abs(factor(found.x)) ** 2)
    return Visibility(
        nrmse=float(left.std() / rms),
        noise_nrmse=float(noise * np.sqrt(1.0 + through.mean()) / rms),
        evidence=_evidence(left * window, through, noise),
        base={
            "stiffness": float(start["stiffness"] * np.exp(found.x[0])),
            "damping": float(start["damping"] * np.exp(found.x[1])),
            "gain": float(1.0 + found.x[2] * GAIN_TOLERANCE),
            "delay": float(found.x[3] * DELAY_TOLERANCE),
        },
    )


def noncentrality(difference: Array, numbers: Mapping[str, float], rate: float, noise: float) -> float:
    """Return the noncentrality of a likelihood-ratio test between two hidden things whose records are known.

    Args:
        difference: of the records without noise, m/s^2, shape (n,).
        numbers: mass, stiffness and damping of the plant, SI.
        rate: Hz.
        noise: rms of white noise in either channel, m/s^2.
    """
    frequency = rfftfreq(difference.size, 1.0 / rate)
    return _evidence(difference, np.abs(transmissibility(numbers, frequency)) ** 2, noise)


def _evidence(left: Array, through: Array, noise: float) -> float:
    density = noise**2 * left.size * (1.0 + through)
    return float(2.0 * np.sum(np.abs(rfft(left)) ** 2 / density))
