"""Filters of a logger, which both channels pass before they are sampled.

They run over the simulated motion. Its values are means over steps far shorter than a sample, so a jump
inside a step keeps its place, and next to nothing of it folds back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import bessel, butter, cheby1, cheby2, firwin, oaconvolve, sosfilt, sosfiltfilt

from spool_blind.field.nuisances import CHANNELS, Array, Generator, slow_delay
from spool_blind.simulator import SpoolMotion

#: Steps of the motion within a sample, at least.
POINTS = 32

NONE, MEAN, LINEAR, CAUSAL = "none", "mean", "linear_phase", "causal"
BUTTERWORTH, SINC = "butterworth", "windowed_sinc"
SHARES = {LINEAR: 0.5, CAUSAL: 0.3, MEAN: 0.1, NONE: 0.1}
#: Share of the filters with a corner whose channels differ: then a quarter of all filters do.
APART = 0.25 * 0.9 / 0.8
#: Corner over the sampling rate.
CORNERS = {LINEAR: (0.36, 0.46), CAUSAL: (0.28, 0.42)}
#: Families of a kind: share, and order from and to.
FAMILIES = {
    LINEAR: {BUTTERWORTH: (0.8, 3, 8), "chebyshev_2": (0.1, 6, 8), SINC: (0.1, 8, 24)},
    CAUSAL: {BUTTERWORTH: (0.7, 2, 8), "bessel": (0.15, 2, 8), "chebyshev_1": (0.15, 2, 8)},
}
#: dB, ripple of Chebyshev's first family and attenuation of the second.
RIPPLE, ATTENUATION = 0.2, 30.0
#: A difference is a jump if it is so many times the bend on either side of it, and m/s^2 at least.
BENDS, LEAST_JUMP = 20.0, 1e-3


@dataclass(frozen=True, slots=True)
class LoggerFilter:
    """Low-pass filter of one channel.

    Attributes:
        rate: samples per second, Hz.
        kind: ``none``, ``mean`` (over a sample, around its instant), ``linear_phase`` or ``causal``.
        family: of ``FAMILIES``; empty where the kind has none.
        order: of each pass, forward and back, for linear phase; half the length of a sinc, in samples.
        corner: Hz, at half the power, for linear phase at half the amplitude.
    """

    rate: float
    kind: str = NONE
    family: str = ""
    order: int = 0
    corner: float = 0.0

    def read(self, signal: Array, motion: SpoolMotion, instants: Array) -> Array:
        """Return the readings (m/s^2) at ``instants`` (s) of ``signal`` (m/s^2, steps of ``motion``)."""
        if self.kind == NONE:
            return sharp(signal, (instants - motion.time[0]) / motion.step)
        if self.kind == MEAN:
            ends, speed = motion.time + 0.5 * motion.step, np.cumsum(signal) * motion.step
            first, last = (np.interp(instants + side / self.rate, ends, speed) for side in (-0.5, 0.5))
            return np.asarray((last - first) * self.rate)
        return np.interp(instants, motion.time, self._through(signal, 1.0 / motion.step))

    @property
    def delay(self) -> float:
        """Delay of slow motions, s."""
        return slow_delay(self._sections, self.rate) if self.kind == CAUSAL else 0.0

    def told(self) -> dict[str, str | float]:
        """Return what is true of it, for JSON, SI units."""
        numbers = {"order": self.order, "corner_Hz": self.corner, "delay_s": self.delay}
        return {"kind": self.kind, "family": self.family, **numbers}

    def _through(self, row: Array, rate: float) -> Array:
        if self.family == SINC:
            taps = firwin(2 * round(self.order * rate / self.rate) + 1, self.corner, fs=rate)
            return np.asarray(oaconvolve(row, taps, mode="same"))
        run = sosfilt if self.kind == CAUSAL else sosfiltfilt
        return np.asarray(run(self._sections(rate), row))

    def _sections(self, rate: float) -> Array:
        order, corner = self.order, self.corner

        def edge(decibels: float) -> float:
            """Return how far the edge of one of Chebyshev's filters is from its corner."""
            swing = 10.0 ** abs(0.5 * np.log10(10.0 ** (0.1 * decibels) - 1.0))
            return float(np.cosh(np.arccosh(swing) / order))

        if self.family == "bessel":
            return np.asarray(bessel(order, corner, norm="mag", fs=rate, output="sos"))
        if self.family == "chebyshev_1":
            return np.asarray(cheby1(order, RIPPLE, corner / edge(RIPPLE), fs=rate, output="sos"))
        if self.family == "chebyshev_2":
            return np.asarray(cheby2(order, ATTENUATION, corner * edge(ATTENUATION), fs=rate, output="sos"))
        return np.asarray(butter(order, corner, fs=rate, output="sos"))


def sharp(row: Array, places: Array) -> Array:
    """Return a motion with jumps at ``places``, in steps from the first middle; ``row`` is its means.

    Values are interpolated, unless there is a jump between: then they are extrapolated from its side. The
    mean over both steps says where the jump is.
    """
    at = np.clip(np.floor(places).astype(np.int64), 3, row.size - 5)
    past = places - at
    left, right = ([row[at + step] for step in away] for away in ((-1, -2, -3), (2, 3, 4)))
    rise, fall = left[0] - left[1], right[0] - right[1]
    high = right[0] + 1.5 * fall
    jump = high - left[0] - 1.5 * rise
    bend = np.maximum(*(np.abs(side[0] - 2.0 * side[1] + side[2]) for side in (left, right)))
    jumps = np.abs(jump) > np.maximum(BENDS * bend, LEAST_JUMP)
    before = past + 0.5 < (2.0 * high - row[at] - row[at + 1]) / np.where(jumps, jump, 1.0)
    beside = np.where(before, left[0] + (1.0 + past) * rise, right[0] + (2.0 - past) * fall)
    return np.where(jumps, beside, row[at] + past * (row[at + 1] - row[at]))


def draw_filters(
    generator: Generator, rate: float, *, alike: bool = False, plain: bool = False
) -> dict[str, LoggerFilter]:
    """Draw the filter of each channel: kind and family are the same, order and corner may differ.

    Args:
        generator: of the numbers.
        rate: samples per second, Hz.
        alike: both channels have the same one.
        plain: those with a corner are Butterworth filters.
    """
    kind = str(generator.choice(list(SHARES), p=list(SHARES.values())))
    apart = generator.random() < APART and not alike
    if kind not in FAMILIES:
        return dict.fromkeys(CHANNELS, LoggerFilter(rate, kind))
    families = FAMILIES[kind]
    family = str(generator.choice(list(families), p=[share for share, _, _ in families.values()]))
    family = BUTTERWORTH if plain else family
    _, least, most = families[family]
    drawn = []
    for _ in CHANNELS:
        order, corner = int(generator.integers(least, most + 1)), float(generator.uniform(*CORNERS[kind]))
        drawn.append(LoggerFilter(rate, kind, family, order, corner * rate))
    return dict(zip(CHANNELS, drawn if apart else drawn[:1] * 2, strict=True))
