"""Transmissibility of mass, spring and viscous drag: the spool with nothing hidden, in closed form."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

#: s in which the last value fades out, and s of rest after it: what is over must not come round to the start.
FADE, REST = 0.5, 4.0


def transmissibility(numbers: Mapping[str, float], frequency: Array, *, travel: bool = False) -> Spectrum:
    """Return spool's over body's acceleration at ``frequency`` (Hz), or travel over it (s^2)."""
    s = 2j * np.pi * frequency
    inner = numbers["damping"] * s + numbers["stiffness"]
    whole = numbers["mass"] * s * s + inner
    return np.asarray(-numbers["mass"] / whole if travel else inner / whole, dtype=np.complex128)


class Padded:
    """Spectrum of a signal that starts from rest, extended so that it ends at rest."""

    def __init__(self, signal: Array, rate: float) -> None:
        fade = round(FADE * rate)
        ending = signal[-1] * (0.5 + 0.5 * np.cos(np.pi * np.arange(1, fade + 1) / fade))
        whole = np.concatenate((signal, ending))
        self.size = signal.size
        self.length = next_fast_len(whole.size + round(REST * rate), real=True)
        self.frequency: Array = rfftfreq(self.length, 1.0 / rate)
        self.spectrum: Spectrum = rfft(whole, self.length)

    def through(self, factor: Spectrum) -> Array:
        """Return the signal after a linear system of this frequency response, shape of the signal."""
        return np.asarray(irfft(self.spectrum * factor, self.length)[: self.size], dtype=np.float64)


def respond(numbers: Mapping[str, float], body: Array, rate: float, *, travel: bool = False) -> Array:
    """Return the spool's acceleration (m/s^2) or travel (m) under ``body`` (from rest, ``rate`` Hz)."""
    padded = Padded(body, rate)
    return padded.through(transmissibility(numbers, padded.frequency, travel=travel))
