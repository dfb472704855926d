"""Force record: a stretch of displacement and force, the data of the kinds ``driven`` and ``imposed``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import gaussian_filter1d
from spool_core.errors import InputError

Array = NDArray[np.float64]

#: Polynomial that velocity and acceleration are taken from, and how much of the fastest motion it spans.
DEGREE = 3
#: Deviations at which the low-pass ends: the kernel of its second derivative must add up to 0, or it reads a
#: spring out of a displacement. At 4 it adds up to 1e-3 of its peak, at 6 to 1e-7.
TRUNCATED = 6.0


@dataclass(frozen=True, slots=True)
class ForceRecord:
    """Evenly spaced samples without gaps.

    Attributes:
        name: of the file.
        start: s, time of the first sample.
        period: s between samples.
        displacement: m, shape (n,).
        force: N, shape (n,).
    """

    name: str
    start: float
    period: float
    displacement: Array
    force: Array

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            InputError: the rows differ in length or hold what is not a number.
        """
        if self.displacement.shape != self.force.shape or self.force.ndim != 1:
            raise InputError(f"{self.name}: displacement and force must be rows of one length")
        if not (np.isfinite(self.displacement).all() and np.isfinite(self.force).all()):
            raise InputError(f"{self.name}: displacement or force is not a number somewhere")

    @property
    def duration(self) -> float:
        """s."""
        return self.force.size * self.period

    @property
    def time(self) -> Array:
        """s, shape (n,)."""
        return np.asarray(self.start + self.period * np.arange(self.force.size), dtype=np.float64)

    def smoothing(self) -> int:
        """Return the odd number of samples over which velocity and acceleration are taken.

        An eighth of the period of the fastest motion that matters, so that the slopes lose about 1 %.
        """
        lines = np.abs(
            np.fft.rfft((self.displacement - self.displacement.mean()) * np.hanning(self.force.size))
        )
        frequency = np.fft.rfftfreq(self.force.size, self.period)
        power = np.cumsum((lines * frequency) ** 2)
        if power[-1] <= 0.0:
            return 5
        fastest = float(frequency[min(np.searchsorted(power, 0.9 * power[-1]), frequency.size - 1)])
        wanted = round(0.125 / max(fastest, 1e-9) / self.period)
        return int(np.clip(wanted | 1, 5, max(5, (self.force.size // 8) | 1)))

    def low_passed(self, row: Array, order: int = 0) -> Array:
        """Return ``row`` (shape (n,), in its unit) through a Gaussian low-pass, or its derivative over time.

        Its deviation is a 32nd of the fastest motion's period: 2 % are lost there. All orders share one
        operator, so a balance of forces that holds for the rows holds for what this makes of them.
        """
        width = max(1.0, 0.25 * self.smoothing())
        passed = gaussian_filter1d(row, width, order=order, mode="nearest", truncate=TRUNCATED)
        return np.asarray(passed) / self.period**order

    @property
    def inner(self) -> Array:
        """1 where ``low_passed`` knows both sides, else 0, shape (n,)."""
        reach = min(self.force.size // 3, int(np.ceil(0.25 * TRUNCATED * self.smoothing())))
        known = np.ones(self.force.size)
        known[:reach] = known[-reach:] = 0.0
        return known

    def derivative(self, order: int) -> Array:
        """Return the displacement's derivative over time, m/s or m/s^2, shape (n,)."""
        return np.asarray(
            signal.savgol_filter(
                self.displacement, self.smoothing(), DEGREE, deriv=order, delta=self.period, mode="interp"
            )
        )
