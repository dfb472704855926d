"""Spectra and filters without phase: noise of channels, and the excitation without it.

All columns pass one and the same linear operator, a gain over frequency without phase: a raised cosine from 0
at ``low_cut`` to 1 at twice that. Integration divides by i omega, so nothing drifts. A record goes on beyond
its ends as its mirror image through the end points; within ``1 / low_cut`` of the ends it is not to be used.

Left in, the resonance would amplify it, and a fit would find more damping, or damping that drifts, better.
Short overlapping pieces of the record keep those frequencies that stand out of the noise, without phase.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy import fft
from numpy.typing import NDArray
from spool_core.numbers import Array, Complex
from spool_core.record_limits import LIMITS

#: Quantile of a smoothed density that stands for its noise floor: harmonics reach into the other lines.
QUANTILE = 0.25
#: s of the pieces that the residual's spectrum is averaged over.
SPECTRUM_PIECE = 2.0

#: Samples beyond both ends that a delayed signal is interpolated from.
EDGE = 256

#: Share of the power that the excitation's band holds.
BAND_SHARE = 0.999
#: Band above the excitation, over its upper end, in which noise is looked at where an anti-alias filter
#: leaves none further up.
ABOVE = (1.3, 4.0)
#: Density over that of white noise from which noise is coloured, or cut off by a filter: 10 dB are more than
#: the density of any white noise scatters.
LOUDER = 10.0
#: Lines that the coherence is averaged over, and lines at least from which a level is taken.
NEIGHBOURS, FEWEST = 5, 8
#: Standard deviations by which the density below exceeds the one above where it is not of white noise alone,
#: and
#: standard deviation of a median over that of a mean, for many samples.
SURE, MEDIAN = 5.0, 1.25

#: Lines of a band that has one level of noise.
BAND = 8
#: s of one piece, and pieces that overlap at each instant.
PIECE, OVERLAP = 1.0, 4
#: Power over that of the noise up to which lines are noise, and from which they are excitation.
NOISE_ONLY, DRIVE_ONLY = 2.0, 5.0
#: Lines on each side over which the power is averaged.
DENOISED_EXCITATION_NEIGHBOURS = 2


@dataclass(frozen=True, slots=True)
class Spectrum:
    """One-sided power density of a residual, (m/s^2)^2/Hz, at ``frequency`` (Hz), both shape (f,)."""

    frequency: Array
    density: Array

    def at(self, frequency: Array) -> Array:
        """Return the density at ``frequency``, same shape."""
        return np.interp(frequency, self.frequency, self.density)


def smoothed(density: Array, least: int, share: float = 0.05) -> Array:
    """Return ``density`` averaged over ``share`` of the frequency, and ``least`` lines, on both sides."""
    half = np.maximum(least, (share * np.arange(density.size)).astype(np.int64))
    total: Array = np.concatenate([[0.0], np.cumsum(density)])
    low = np.maximum(0, np.arange(density.size) - half)
    high = np.minimum(density.size, np.arange(density.size) + half + 1)
    return np.asarray((total[high] - total[low]) / (high - low))


def floor_of(density: Array) -> float:
    """Return the noise floor: the level of the quieter lines of the upper half of ``density``."""
    upper = density[density.size // 2 : max(density.size // 2 + 1, int(0.97 * density.size))]
    width = max(1, upper.size // 40)
    smooth = np.convolve(upper, np.full(width, 1.0 / width), mode="valid")
    return max(float(np.quantile(smooth, QUANTILE)), 1e-30)


def residual_spectrum(rows: Sequence[Array], sample_period: float) -> Spectrum:
    """Return the smoothed spectrum of the residuals ``rows``, one (n,) for each window.

    ``sample_period`` in s.
    """
    frequency, density = density_of(rows, sample_period, SPECTRUM_PIECE)
    # Noise is smooth, and weights must not follow chance.
    smooth = smoothed(density, 2)
    return Spectrum(frequency, np.maximum(smooth, 1e-6 * float(smooth.max()) + 1e-30))


def density_of(
    rows: Sequence[Array], sample_period: float, seconds: float = 1.0, average: str = "mean"
) -> tuple[Array, Array]:
    """Return frequency (Hz) and power density of ``rows``, shapes (n,), whose mean is taken as it is.

    Welch's method with pieces of ``seconds`` s, weighed by the rows' lengths; ``average`` is over the pieces.
    """
    piece = min(*(row.size for row in rows), max(16, round(seconds / sample_period)))
    densities = []
    for row in rows:
        lines = _pieces(row, 1.0 / sample_period, piece)
        power = lines.real**2 + lines.imag**2
        if average == "median":
            # Of few squares of noise the median lies this much below the mean (Allen et al. 2012, app. B).
            signs = np.resize([1.0, -1.0], len(power) - 1 + len(power) % 2)
            densities.append(np.median(power, axis=0) / np.sum(signs / (1.0 + np.arange(signs.size))))
        else:
            densities.append(power.mean(axis=0))
    density = np.average(densities, axis=0, weights=[row.size for row in rows])
    return frequencies(piece, sample_period), np.asarray(density)


@dataclass(frozen=True, slots=True)
class CrossSpectrum:
    """Power densities of ``body`` and ``spool`` over ``frequency`` (Hz), and their ``cross`` density."""

    frequency: Array
    body: Array
    spool: Array
    cross: NDArray[np.complex128]

    @property
    def amplification(self) -> Array:
        """Spool over body."""
        return np.asarray(np.abs(self.cross) / np.maximum(self.body, 1e-300))

    @property
    def coherence(self) -> Array:
        """Share of the spool's power that the body accounts for; 1 throughout for a single piece."""
        return np.asarray(np.abs(self.cross) ** 2 / np.maximum(self.body * self.spool, 1e-300))


def cross_spectrum(body: Array, spool: Array, rate: float, piece: int) -> CrossSpectrum:
    """Return the spectra of both channels, shapes (n,), at ``rate`` (Hz), by pieces of ``piece`` samples."""
    piece = min(piece, body.size)
    one, other = _pieces(body, rate, piece, level=True), _pieces(spool, rate, piece, level=True)
    density, other_density = (np.mean(row.real**2 + row.imag**2, axis=0) for row in (one, other))
    cross = np.mean(np.conj(one) * other, axis=0)
    return CrossSpectrum(frequencies(piece, 1.0 / rate), density, other_density, cross)


def _pieces(row: Array, rate: float, piece: int, *, level: bool = False) -> Complex:
    """Return the lines of pieces of ``row``, shape (n,), that overlap by half, under a Hann taper.

    Their squares are one-sided power densities, shape (pieces, piece // 2 + 1). With ``level`` each piece is
    taken without its mean.
    """
    cut = np.lib.stride_tricks.sliding_window_view(row, piece)[:: piece - piece // 2]
    taper = np.hanning(piece + 1)[:-1]
    scale = np.full(piece // 2 + 1, np.sqrt(2.0 / (rate * np.sum(taper**2))))
    # Frequency 0, and that of half the rate where it is a line, have no counterpart below 0.
    scale[[0, -1] if piece % 2 == 0 else 0] /= np.sqrt(2.0)
    if level:
        cut = cut - cut.mean(axis=1, keepdims=True)
    return np.asarray(fft.rfft(cut * taper) * scale)


def frequencies(count: int, period: float) -> Array:
    """Return the frequencies (Hz) of the lines of ``count`` samples ``period`` s apart."""
    return np.asarray(fft.rfftfreq(count, period), dtype=np.float64)


def fast_length(count: int) -> int:
    """Return the smallest product of 2, 3 and 5 from ``count`` on: transforms of that length are fast."""
    best = 1 << (count - 1).bit_length()
    fives = 1
    while fives < best:
        product = fives
        while product < best:
            best = min(best, product << (-(-count // product) - 1).bit_length())
            product *= 3
        fives *= 5
    return best


@dataclass(frozen=True, slots=True)
class ZeroPhase:
    """A zero-phase band-pass, the same for every column.

    Attributes:
        sample_period: s.
        low_cut: Hz, 0 gain below; full gain from twice this on.
        high_cut: Hz, full gain below; 0 gain from 1.25 times this on. Infinite for no upper edge.
    """

    sample_period: float
    low_cut: float
    high_cut: float = float("inf")

    @property
    def settling(self) -> int:
        """Samples at each end that the mirror images reach."""
        return round(1.0 / (self.low_cut * self.sample_period)) if self.low_cut > 0.0 else 0

    def gain(self, frequency: Array) -> Array:
        """Return the gain at ``frequency`` (Hz, >= 0), same shape."""
        gain = np.ones(frequency.shape)
        if self.low_cut > 0.0:
            gain *= _rise(frequency / self.low_cut - 1.0)
        if np.isfinite(self.high_cut):
            gain *= 1.0 - _rise(4.0 * (frequency / self.high_cut - 1.0))
        return gain

    def apply(self, columns: Array, integrations: int = 0) -> Array:
        """Return ``columns`` (..., n) filtered and integrated ``integrations`` times over time (s)."""
        n = columns.shape[-1]
        reach = min(n - 1, 2 * self.settling + 16)
        length = fast_length(n + 2 * reach)
        frequency = frequencies(length, self.sample_period)
        response = self.gain(frequency).astype(np.complex128)
        if integrations:
            response[0] = 0.0
            response[1:] /= (2j * np.pi * frequency[1:]) ** integrations
        padding = [(0, 0)] * (columns.ndim - 1) + [(reach, reach)]
        continued = np.pad(columns, padding, mode="reflect", reflect_type="odd") if reach else columns
        filtered = fft.irfft(fft.rfft(continued, length, axis=-1) * response, length, axis=-1)
        return np.asarray(filtered[..., reach : reach + n])


def delayed(rows: Array, delay: float, period: float) -> Array:
    """Return ``rows`` (..., n), a sample every ``period`` s, later by ``delay`` s, band-limited between."""
    count = rows.shape[-1]
    reach = min(count - 1, EDGE)
    padding = [(0, 0)] * (rows.ndim - 1) + [(reach, reach)]
    padded = np.pad(rows, padding, mode="reflect", reflect_type="odd")
    frequency = frequencies(padded.shape[-1], period)
    lines = np.fft.rfft(padded) * np.exp(-2j * np.pi * frequency * delay)
    return np.asarray(np.fft.irfft(lines, padded.shape[-1])[..., reach : reach + count])


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """How the spool moves in its body; every array has shape (n,).

    Attributes:
        displacement, velocity, acceleration: relative, m, m/s, m/s^2.
        spool: acceleration of the spool itself, m/s^2.
        settling: samples at each end that are not to be used.
    """

    displacement: Array
    velocity: Array
    acceleration: Array
    spool: Array
    settling: int


def relative_motion(body: Array, spool: Array, conditioning: ZeroPhase) -> RelativeMotion:
    """Return the relative motion from both accelerations (m/s^2, shape (n,))."""
    relative = spool - body
    return RelativeMotion(
        conditioning.apply(relative, 2),
        conditioning.apply(relative, 1),
        conditioning.apply(relative),
        conditioning.apply(spool),
        conditioning.settling,
    )


@dataclass(frozen=True, slots=True)
class ChannelNoise:
    """Noise and excitation of one record.

    Attributes:
        body, spool: one-sided power density of the noise, (m/s^2)^2/Hz.
        low, high: band that holds nearly all of the excitation, Hz.
        rate: samples per second.
        noisy_below: Hz, below which coloured noise drowns what the spool has of the body's motion; 0 where
            that noise is white.
        spool_is_bound: the spool's noise is an upper bound: its density falls with frequency even above the
            excitation, as it does where harmonics of dry friction reach up there, or no such band is left.
    """

    body: float
    spool: float
    low: float
    high: float
    rate: float
    noisy_below: float = 0.0
    spool_is_bound: bool = True

    @property
    def body_rms(self) -> float:
        """White noise of the body's channel, m/s^2."""
        return float(np.sqrt(self.body * 0.5 * self.rate))

    @property
    def spool_rms(self) -> float:
        """White noise of the spool's channel, m/s^2."""
        return float(np.sqrt(self.spool * 0.5 * self.rate))


def noise_of(body: Array, spool: Array, rate: float) -> ChannelNoise:
    """Return noise and excitation band of readings (m/s^2, shape (n,)) that come at ``rate`` (Hz)."""
    piece = int(min(body.size, max(256, 2 ** round(np.log2(rate)))))
    both = cross_spectrum(body, spool, rate, piece)
    frequency, density, spool_density = both.frequency, both.body, both.spool
    noise, spool_noise = floor_of(density), floor_of(spool_density)
    total = np.cumsum(np.maximum(density - 3.0 * noise, 0.0))
    if total[-1] <= 0.0:
        return ChannelNoise(noise, spool_noise, 0.0, 0.5 * rate, rate)
    share = total / total[-1]
    low = float(frequency[np.searchsorted(share, 1.0 - BAND_SHARE)])
    high = float(frequency[min(int(np.searchsorted(share, BAND_SHARE)), frequency.size - 1)])
    near = (frequency > ABOVE[0] * high) & (frequency < min(ABOVE[1] * high, 0.45 * rate))
    if np.count_nonzero(near) >= FEWEST:
        level = float(np.quantile(density[near], QUANTILE))
        if level > LOUDER * noise:
            noise = level
            spool_noise = max(spool_noise, float(np.quantile(spool_density[near], QUANTILE)))
    edge = _coherent_from(both) if body.size > 10 * piece else 0.0
    below = (frequency > 0.5) & (frequency < 0.8 * edge)
    drowned = below.any() and float(np.median(spool_density[below])) > LOUDER * spool_noise
    bound = _falls(frequency, spool_density, (ABOVE[0] * high, 0.45 * rate), body.size / piece)
    return ChannelNoise(noise, spool_noise, low, high, rate, 0.8 * edge if drowned else 0.0, bound)


@cache
def _calmest() -> float:
    """Return the mean of the calmest quarter of a band's pieces over its level.

    The power of normal noise has a gamma distribution.
    """
    from scipy import special  # noqa: PLC0415 - slow to load

    return float(special.gammainc(BAND + 1, special.gammaincinv(BAND, QUANTILE))) / QUANTILE


def resting_noise(body: Array, spool: Array, white: float, rate: float) -> Array:
    """Return frequencies (Hz) and the density of the body's noise there, (m/s^2)^2/Hz, shape (2, bands).

    It is that of the quietest pieces of a band that is excited at other times, if the spool does not follow
    the body there at any line, with a separate transfer (it turns at the resonance): that is vibration across
    the sensor's axis. Elsewhere it is ``white``.
    """
    piece = min(body.size, round(rate))
    one, other = (_pieces(row, rate, piece) for row in (body, spool))
    lines, found = np.fft.rfftfreq(piece, 1.0 / rate), [(0.0, white)]
    for begin in range(1, lines.size - BAND, BAND):
        cut = slice(begin, begin + BAND)
        density = np.mean(np.abs(one[:, cut]) ** 2, axis=1)
        calm = density <= np.quantile(density, QUANTILE)
        level, first, second = float(density[calm].mean()) / _calmest(), one[calm, cut], other[calm, cut]
        together = np.abs(np.sum(first.conj() * second, axis=0)) ** 2
        followed = float(np.sum(together / np.maximum(np.sum(np.abs(second) ** 2, axis=0), 1e-300)))
        resting = float(density.max()) > LOUDER * level and followed < LIMITS.coherent * float(
            np.sum(np.abs(first) ** 2)
        )
        found.append((float(lines[cut].mean()), max(white, level) if resting else white))
    return np.array(found).T


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
    level = density(frequencies(length, 1.0 / rate)) if callable(density) else density
    expected = level * 0.5 * rate * float(np.sum(window**2))
    count = (padded.size - length) // hop + 1
    gains = np.empty((count, length // 2 + 1))
    for number in range(count):
        power = np.abs(np.fft.rfft(padded[number * hop : number * hop + length] * window)) ** 2 / expected
        mean = smoothed(power, DENOISED_EXCITATION_NEIGHBOURS, 0.0)
        gains[number] = np.clip((mean - NOISE_ONLY) / (DRIVE_ONLY - NOISE_ONLY), 0.0, 1.0)
    return Quiet(gains, length, samples.size)


def faded(count: int, reach: int) -> Array:
    """Return ``count`` weights that rise and fall as a cosine over ``reach`` samples at both ends."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(reach) + 0.5) / max(reach, 1))
    weights = np.ones(count)
    weights[:reach], weights[count - reach :] = rise, rise[::-1]
    return weights


def _rise(share: Array) -> Array:
    """Return the raised cosine from 0 (share <= 0) to 1 (share >= 1)."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0)))


def _falls(frequency: Array, density: Array, band: tuple[float, float], pieces: float) -> bool:
    """Return whether a density, averaged over ``pieces``, is higher in the lower half of a band (Hz)."""
    middle = 0.5 * (band[0] + band[1])
    lower = density[(frequency > band[0]) & (frequency < middle)]
    upper = density[(frequency >= middle) & (frequency < band[1])]
    if min(lower.size, upper.size) < FEWEST:
        return True
    scatter = MEDIAN * float(np.sqrt((1.0 / lower.size + 1.0 / upper.size) / max(pieces, 1.0)))
    return float(np.median(lower)) > (1.0 + SURE * scatter) * float(np.median(upper))


def _coherent_from(both: CrossSpectrum) -> float:
    """Return the lowest frequency (Hz) at which the spool follows the body, 0 where there is none."""
    width = np.ones(NEIGHBOURS) / NEIGHBOURS
    one, other, real, imaginary = (
        np.convolve(row, width, mode="same")
        for row in (both.body, both.spool, both.cross.real, both.cross.imag)
    )
    coherent = (real**2 + imaginary**2) / np.maximum(one * other, 1e-300) > LIMITS.coherent
    return float(both.frequency[np.argmax(coherent)]) if coherent.any() else 0.0


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
