"""Denoised excitation: freed of the body sensor's noise, which moves no spool.

Left in, the resonance would amplify it, and a fit would find more damping, or damping that drifts, better.
Short overlapping pieces of the record keep those frequencies that stand out of the noise, without phase.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: s of one piece, and pieces that overlap at each instant.
PIECE, OVERLAP = 1.0, 4
#: Power over that of the noise up to which lines are noise, and from which they are excitation.
NOISE_ONLY, DRIVE_ONLY = 2.0, 5.0
#: Lines on each side over which the power is averaged.
NEIGHBOURS = 2


@dataclass(frozen=True, slots=True)
class Quiet:
    """Gains over time and frequency.

    Attributes:
        gains: 0 to 1, shape (pieces, lines).
        length: samples of a piece.
        size: samples of the record.
    """

    gains: Array
    length: int
    size: int

    def apply(self, samples: Array) -> Array:
        """Return ``samples`` (n,) with the gains applied."""
        hop = self.length // OVERLAP
        padded = _padded(samples, self.length)
        window = _window(self.length)
        total, weight = np.zeros(padded.size), np.zeros(padded.size)
        for number, gain in enumerate(self.gains):
            part = slice(number * hop, number * hop + self.length)
            total[part] += np.fft.irfft(np.fft.rfft(padded[part] * window) * gain, self.length)
            weight[part] += window
        inside = slice(self.length, self.length + self.size)
        return np.asarray(total[inside] / weight[inside])


def quiet(samples: Array, density: float | Callable[[Array], Array], rate: float) -> Quiet:
    """Return what keeps the excitation in ``samples`` (n,) and takes noise of ``density`` off.

    Args:
        samples: as read, shape (n,).
        density: one-sided power density of the noise, unit^2/Hz, at all frequencies (Hz), or by frequency.
        rate: samples per second.
    """
    length = max(OVERLAP * 4, OVERLAP * round(PIECE * rate / OVERLAP))
    length = min(length, OVERLAP * (samples.size // OVERLAP))
    hop = length // OVERLAP
    padded = _padded(samples, length)
    window = _window(length)
    level = (
        density(np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64))
        if callable(density)
        else density
    )
    expected = level * 0.5 * rate * float(np.sum(window**2))
    count = (padded.size - length) // hop + 1
    gains = np.empty((count, length // 2 + 1))
    for number in range(count):
        power = np.abs(np.fft.rfft(padded[number * hop : number * hop + length] * window)) ** 2 / expected
        total = np.concatenate([[0.0], np.cumsum(power)])
        place = np.arange(power.size)
        low, high = np.maximum(0, place - NEIGHBOURS), np.minimum(power.size, place + NEIGHBOURS + 1)
        mean = (total[high] - total[low]) / (high - low)
        gains[number] = np.clip((mean - NOISE_ONLY) / (DRIVE_ONLY - NOISE_ONLY), 0.0, 1.0)
    return Quiet(gains, length, samples.size)


def _window(length: int) -> Array:
    return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length))


def _padded(samples: Array, length: int) -> Array:
    """Return ``samples`` with a piece before and one after, in whole hops: the mirror image."""
    hop = length // OVERLAP
    after = length + (-samples.size) % hop
    reach = min(length, samples.size - 1)
    inside = np.pad(samples, (reach, min(after, samples.size - 1)), mode="reflect", reflect_type="odd")
    short = length - reach
    return np.pad(inside, (short, max(0, length + samples.size + after - short - inside.size)))
