"""What both channels themselves show in a window: levels, means, flat tops, cross-spectra."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from spool_stream.block import Samples
from spool_stream.compiled import compiled

from .window import Array, Complex, Window

#: Hz, the band of the spectra; the upper end is 0.4 of the sample rate where that is less.
BAND = (3.0, 200.0)

#: Depths, as a share of half the span, of the strip at a channel's extremes that a flat top fills.
DEPTHS = (0.002, 0.02)

#: Times as long in that strip as in those below it that no wave spends there.
FLATTER = 6


@dataclass(frozen=True, slots=True)
class Channel:
    """One channel in a window: ``mean`` and ``rms`` (about the mean) in m/s^2.

    ``flat_top`` is the share of samples that lie on a flat top at the upper or lower extreme, 0 where the
    extremes are those of a wave; ``constant`` whether no sample differs from another.
    """

    mean: float
    rms: float
    flat_top: float
    constant: bool


@dataclass(frozen=True, slots=True)
class Signals:
    """Both channels in the window that ends at ``stamp`` (ns, newest sample).

    ``frequency`` (Hz), ``body_power``, ``spool_power`` ((m/s^2)^2 per line) and ``cross`` (spool times
    conjugate of body) have shape (lines,); the powers of a stationary signal add to its mean square.

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
    cross: Complex
    relative_rms: float
    relative_velocity: float
    dissipation: float


def look(window: Window) -> Signals:
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
        body=_channel(window.samples[0], window.means[0]),
        spool=_channel(window.samples[1], window.means[1]),
        frequency=frequency,
        body_power=body,
        spool_power=spool,
        cross=cross,
        relative_rms=math.sqrt(relative),
        relative_velocity=math.sqrt(squared),
        dissipation=-work / squared if squared > 0.0 else math.nan,
    )


def _channel(samples: Samples, mean: float) -> Channel:
    square, flat, constant = levels(samples, mean)
    return Channel(mean, math.sqrt(square), flat, constant)


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
def levels(samples: Samples, mean: float) -> tuple[float, float, bool]:
    """Return mean square about ``mean``, share of samples on flat tops, and whether all are equal."""
    low = high = np.float64(samples[0])
    square = 0.0
    for sample in samples:
        value = np.float64(sample)
        low, high = min(low, value), max(high, value)
        square += (value - mean) ** 2
    flat = 0.0
    if high > low:
        half = 0.5 * (high - low)
        flat = flat_top(samples, high, half) + flat_top(samples, low, -half)
    return square / samples.size, flat, high == low


@compiled
def flat_top(samples: NDArray[np.floating], peak: float, half: float) -> float:
    """Return the share of ``samples`` on a flat top at ``peak``, 0 for the top of any wave.

    ``half`` of the span is positive at the upper extreme and negative at the lower one.

    A sine spends as long within a depth below its peak as in the strip from there to four times that depth,
    the flattest sum of two waves (a top with two humps) 4.4 times as long; a clipped one spends much more,
    and neighbours of each sample in the strip lie in it too.
    """
    side = math.copysign(1.0, half)
    for depth in DEPTHS:
        top, strip = side * (peak - depth * half), side * (peak - 4.0 * depth * half)
        count = pairs = triples = below = run = 0
        for sample in samples:
            value = side * float(sample)
            if value < strip:
                run = 0
            elif value < top:
                run = 0
                below += 1
            else:
                run += 1
                count += 1
                pairs += run > 1
                triples += run > 2
        # A wave whose period is a whole number of samples may show the same two of each top.
        long_enough = pairs >= max(4.0, 0.005 * samples.size) and triples >= 0.02 * pairs
        if long_enough and count > FLATTER * (below + 1):
            return count / samples.size
    return 0.0
