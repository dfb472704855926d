"""Cross spectra of two signals: averaged over pieces, with how many independent averages they are worth.

Welch, P. D.: The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
Electroacoust. 15 (1967), for averages of pieces that overlap; Bendat, J. S., Piersol, A. G.: Random Data, 4th
edition (2010), section 9.2, for errors of frequency responses and coherence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_core.errors import InputError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: s of a piece at most: lines of 0.5 Hz, finer than the resonance of any spool is wide.
LONGEST_PIECE = 2.0
#: s of a piece at least, and pieces at least: fewer averages make any coherence look high.
SHORTEST_PIECE, LEAST_PIECES = 0.25, 6
#: Squared correlation of the powers of neighbouring Hann pieces that overlap by half (Welch 1967).
OVERLAP = 1.0 / 36.0
#: Share of the largest power density of the drive below which nothing is said of a frequency.
EXCITED = 1e-4
#: Hz, below which accelerometers show their drift.
LOWEST = 1.0


@dataclass(frozen=True, slots=True)
class CrossSpectra:
    """Averaged one-sided densities of a drive x and an answer y; every array has shape (f,).

    Attributes:
        frequency: Hz.
        drive: power density of x, unit(x)^2/Hz.
        answer: of y, unit(y)^2/Hz.
        cross: of both, conj(X) Y.
        averages: independent averages that the overlapping pieces are worth.
        seconds: of data.
    """

    frequency: Array
    drive: Array
    answer: Array
    cross: Complex
    averages: float
    seconds: float

    @property
    def response(self) -> Complex:
        """H1 estimate of the frequency response, y over x: noise of the answer averages out of it."""
        return np.asarray(self.cross / np.maximum(self.drive, 1e-300))

    @property
    def coherence(self) -> Array:
        """Share of the answer's power that follows linearly from the drive, 0 to 1."""
        power = np.maximum(self.drive * self.answer, 1e-300)
        return np.asarray(np.clip(np.abs(self.cross) ** 2 / power, 0.0, 1.0))

    @property
    def relative_error(self) -> Array:
        """Standard deviation of the response's magnitude over it, and of its phase in rad.

        Bendat and Piersol (2010), table 9.6: sqrt(1 - coherence) / sqrt(2 averages coherence).
        """
        coherence = np.maximum(self.coherence, 1e-12)
        return np.asarray(np.sqrt((1.0 - coherence) / (2.0 * self.averages * coherence)))

    @property
    def excited(self) -> NDArray[np.bool_]:
        """Where the drive has power enough to say something."""
        inside = self.frequency >= LOWEST
        return np.asarray(inside & (self.drive > EXCITED * float(self.drive[inside].max(initial=0.0))))


def cross_spectra(drives: Sequence[Array], answers: Sequence[Array], period: float) -> CrossSpectra:
    """Return the spectra of rows of samples, ``period`` s apart, each row without a gap.

    Raises:
        InputError: the rows are too short for enough averages.
    """
    sizes = [row.size for row in drives]
    total, longest = sum(sizes), max(sizes, default=0)
    # Pieces overlap by half: n of them need (n + 1) / 2 of their length.
    seconds = min(LONGEST_PIECE, longest * period, 2.0 * total * period / (LEAST_PIECES + 1))
    piece = round(seconds / period)
    if seconds < SHORTEST_PIECE or piece < 16:
        raise InputError(
            f"{total * period:.2f} s without a gap are too short to average spectra: "
            f"{0.5 * SHORTEST_PIECE * (LEAST_PIECES + 1):.1f} s are needed"
        )
    taper = np.asarray(np.hanning(piece + 2)[1:-1], dtype=np.float64)
    scale = 2.0 * period / float(np.sum(taper**2))
    sums = [np.zeros(piece // 2 + 1, np.complex128) for _ in range(3)]
    count = 0
    for drive, answer in zip(drives, answers, strict=True):
        for first in range(0, drive.size - piece + 1, max(1, piece // 2)):
            x, y = (_lines(row[first : first + piece], taper) for row in (drive, answer))
            for place, part in enumerate((np.abs(x) ** 2, np.abs(y) ** 2, np.conj(x) * y)):
                sums[place] += part
            count += 1
    if count < LEAST_PIECES // 2:
        raise InputError(f"only {count} pieces of {seconds:.2f} s hold no gap: too few to average")
    xx, yy, xy = (scale / count * part for part in sums)
    worth = count / (1.0 + 2.0 * OVERLAP * (count - 1) / count)
    frequency = np.asarray(np.fft.rfftfreq(piece, period), dtype=np.float64)
    return CrossSpectra(frequency, xx.real.copy(), yy.real.copy(), xy, worth, total * period)


def _lines(row: Array, taper: Array) -> Complex:
    return np.asarray(np.fft.rfft((row - row.mean()) * taper))


def linear_transmissibility(frequency: Array, mass: float, damping: float, stiffness: float) -> Complex:
    """Return spool over body acceleration of a linear valve at ``frequency`` (Hz), shape (f,).

    (k + i w c) / (k - m w^2 + i w c), with kg, N s/m and N/m.
    """
    omega = 2.0 * math.pi * frequency
    force = stiffness + 1j * omega * damping
    return np.asarray(force / (force - mass * omega**2))
