"""Channel signals: what both channels show in a window: levels, means, flat tops, cross-spectra."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from spool_core.block import Samples
from spool_core.kernels.compiled import compiled
from spool_estimator.identification.signals.clipping import flat_top

from .window import Array, Complex, SignalWindow

#: s before a standstill in which a channel's span is looked at.
BEFORE = 0.1

#: Hz, the band of the spectra; the upper end is 0.4 of the sample rate where that is less.
BAND = (3.0, 200.0)


class Channel(NamedTuple):
    """Channel in a window: ``mean`` and ``rms`` (about the mean) in m/s^2.

    ``flat_top`` is the share of samples that lie on a flat top at the upper or lower extreme, 0 where the
    extremes are those of a wave. ``standing`` (s) is how long the newest sample has not changed, at most the
    window's length, which ``constant`` says; ``step`` (m/s^2) is the smallest change between two samples, NaN
    where none changes, and ``before`` (m/s^2) the span of the last samples before ``standing``, NaN where
    they are not in the window.
    """

    mean: float
    rms: float
    flat_top: float
    constant: bool
    standing: float = 0.0
    step: float = math.nan
    before: float = math.nan


class Signals(NamedTuple):
    """Signals of both channels in the window that ends at ``stamp`` (ns, newest sample).

    ``frequency`` (Hz), ``body_power``, ``spool_power`` ((m/s^2)^2 per line) and ``cross`` (spool times
    conjugate of body) have shape (lines,); the powers of a stationary signal add to its mean square, which
    ``body_total`` and ``spool_total`` are.

    ``relative_rms`` (m/s^2) and ``relative_velocity`` (m/s rms) are of the spool in the body within the band.
    ``dissipation``, 1/s, is the damping that the energy of that motion shows: power Re(S conj(V)) over
    -abs(V)^2, V = (S - B) / (j w) being the relative velocity. It is negative where the channels can't belong
    to a passive valve, 0 where they have nothing in common, NaN where nothing moves.
    """

    stamp: int
    body: Channel
    spool: Channel
    frequency: Array
    body_power: Array
    spool_power: Array
    body_total: float
    spool_total: float
    cross: Complex
    relative_rms: float
    relative_velocity: float
    dissipation: float


def look(window: SignalWindow) -> Signals:
    """Return what the channels show in ``window``."""
    size = window.samples.shape[1]
    low = max(1, math.ceil(BAND[0] / window.step))
    high = min(size // 2, math.floor(min(BAND[1] / window.step, 0.4 * size)))
    # Mean square by Parseval: two-sided, the taper's energy taken out.
    scale = 2.0 / (size * window.energy)
    frequency, body, spool, cross, sums = spectra(
        window.spectrum, low, max(low, high) + 1, window.step, scale
    )
    relative, squared, work = sums
    return Signals(
        stamp=window.stamp,
        body=_channel(window.samples[0], window.means[0], 1.0 / (window.step * size)),
        spool=_channel(window.samples[1], window.means[1], 1.0 / (window.step * size)),
        frequency=frequency,
        body_power=body,
        spool_power=spool,
        body_total=float(np.add.reduce(body)),
        spool_total=float(np.add.reduce(spool)),
        cross=cross,
        relative_rms=math.sqrt(relative),
        relative_velocity=math.sqrt(squared),
        dissipation=-work / squared if squared > 0.0 else math.nan,
    )


def _channel(samples: Samples, mean: float, period: float) -> Channel:
    square, flat, standing, step = levels(samples, mean)
    changing, count, before = samples.size - 1 - standing, round(BEFORE / period), math.nan
    if standing and changing >= count:
        before = float(np.ptp(samples[changing - count : changing]))
    constant = standing == samples.size - 1
    return Channel(mean, math.sqrt(square), flat, constant, standing * period, step, before)


@compiled
def spectra(
    spectrum: Complex, first: int, last: int, step: float, scale: float
) -> tuple[Array, Array, Array, Complex, tuple[float, float, float]]:
    """Return frequency, powers of body and spool and cross-power of the lines from ``first`` before ``last``.

    And sums over them: of the relative acceleration's power, of the relative velocity's, and of the power
    that the relative motion gives, per mass.
    """
    count = last - first
    frequency, body, spool = np.empty(count), np.empty(count), np.empty(count)
    cross = np.empty(count, np.complex128)
    relative = squared = work = 0.0
    for i in range(count):
        one, other = spectrum[0, first + i], spectrum[1, first + i]
        frequency[i] = (first + i) * step
        body[i] = scale * (one.real**2 + one.imag**2)
        spool[i] = scale * (other.real**2 + other.imag**2)
        cross[i] = scale * (other * one.conjugate())
        power = scale * ((other.real - one.real) ** 2 + (other.imag - one.imag) ** 2)
        w = 2.0 * math.pi * frequency[i]
        relative += power
        squared += power / w**2
        work += cross[i].imag / w
    return frequency, body, spool, cross, (relative, squared, work)


@compiled
def levels(samples: Samples, mean: float) -> tuple[float, float, int, float]:
    """Return mean square about ``mean``, share of samples on flat tops, and how samples change.

    That is how many of the newest ones equal the one before them, and the smallest change, NaN for none.
    """
    low = high = np.float64(samples[0])
    square = 0.0
    standing = -1
    step = math.inf
    previous = low
    for sample in samples:
        value = np.float64(sample)
        if value == previous:
            standing += 1
        else:
            standing = 0
            step = min(step, abs(value - previous))
        previous = value
        low, high = min(low, value), max(high, value)
        square += (value - mean) ** 2
    flat = 0.0
    if high > low:
        half = 0.5 * (high - low)
        flat = flat_top(samples, high, half) + flat_top(samples, low, -half)
    return square / samples.size, flat, standing, step if high > low else math.nan
