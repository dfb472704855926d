"""Information by frequency band: what a record could have told, whatever was fitted to it.

For an answer Y = H X + N of noise density S_n over T s the Fisher information of a number q of H is

    I = 2 T int |dH/dq|^2 S_x / S_n df

(Whittle's likelihood; Ljung, L.: System Identification, 2nd edition (1999), section 7.4 and 8.4). With
q = log k or log c the inverse square root is the relative standard deviation that the band alone would give.
It is a bound from above: what a piece of the averages smears of a resonance counts as noise here.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .cross_spectra import CrossSpectra, linear_transmissibility

Array = NDArray[np.float64]

#: Hz, edges of the bands; the last one ends at half the sample rate.
EDGES = (2.0, 5.0, 10.0, 20.0, 35.0, 60.0, 100.0, 200.0, 400.0)
#: Relative step of the response's derivatives.
STEP = 1e-4
#: Share of incoherent power at least: no coherence is known better than its averages tell.
LEAST_NOISE = 1e-6


@dataclass(frozen=True, slots=True)
class Band:
    """One band.

    Attributes:
        low, high: Hz.
        drive: rms of the drive in it, in its unit.
        coherence: mean over the band, weighed by the drive's power; NaN without drive.
        stiffness, damping: Fisher information of the logarithm of each number, 1; NaN where it is not known.
    """

    low: float
    high: float
    drive: float
    coherence: float
    stiffness: float
    damping: float


def bands_of(
    spectra: CrossSpectra, mass: float = np.nan, damping: float = np.nan, stiffness: float = np.nan
) -> tuple[Band, ...]:
    """Return the bands of ``spectra``; without mass (kg), drag (N s/m) and spring (N/m) no information."""
    frequency = spectra.frequency
    step = float(frequency[1])
    information = {}
    noise = np.maximum((1.0 - spectra.coherence), LEAST_NOISE) * spectra.answer
    weight = 2.0 * spectra.seconds * step * spectra.drive / np.maximum(noise, 1e-300)
    for name, changed in (
        ("stiffness", (damping, stiffness * (1.0 + STEP))),
        ("damping", (damping * (1.0 + STEP), stiffness)),
    ):
        with np.errstate(invalid="ignore", divide="ignore"):  # no mass, no spring: nothing is known of them
            slope = (
                linear_transmissibility(frequency, mass, *changed)
                - linear_transmissibility(frequency, mass, damping, stiffness)
            ) / STEP
        information[name] = np.where(spectra.excited, np.abs(slope) ** 2 * weight, 0.0)
    top = float(frequency[-1])
    edges = [*(edge for edge in EDGES if edge < top), top]
    found = []
    for low, high in pairwise(edges):
        inside = (frequency >= low) & (frequency < high)
        power = spectra.drive[inside]
        total = float(power.sum())
        heard = inside & spectra.excited
        seen = spectra.drive[heard]
        coherence = float(spectra.coherence[heard] @ seen / seen.sum()) if heard.any() else np.nan
        parts = [float(information[name][inside].sum()) for name in ("stiffness", "damping")]
        found.append(Band(low, high, float(np.sqrt(total * step)), coherence, *parts))
    return tuple(found)
