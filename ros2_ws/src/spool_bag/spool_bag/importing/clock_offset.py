"""Offset between two clocks, found in the signals; dry friction delays the spool.

The spool follows the body through the valve's springs, so that a mere correlation is off by the group delay
of that motion. The cross-spectrum is therefore explained by both: the response of a mass on springs to the
motion of its base (Harris and Piersol, Harris' Shock and Vibration Handbook, 5th edition, chapter 2) and a
delay that grows with time.

Cross-spectra know a linear spool alone; friction moves their phase by some tenths of a millisecond. The
suite's own fit of springs, viscous and dry friction tells the delay beside them. Of a spool the mass scales
forces and nothing else, so that none needs to be known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft, ndimage, optimize, signal
from spool_core.errors import InputError
from spool_core.numbers import Array, Complex
from spool_core.record_limits import LIMITS
from spool_estimator.identification.fit import fit
from spool_estimator.identification.fit_result import SPOOL_DELAY, FitSettings
from spool_estimator.identification.record import Record
from spool_sim.model import load_model
from spool_sim.valve import Valve

from spool_bag.importing.time_axis import ClockOffset

#: Hz that both channels are brought to: no spool follows its body beyond a tenth of it.
COMMON_RATE = 400.0
#: Hz, band that is looked at: below, sensors drift; above, nothing of the body's motion reaches the spool.
BAND = (2.0, 120.0)
#: s of the first, coarse correlation's windows, and their number.
WINDOW, WINDOWS = 20.0, 16
#: s of the segments of cross-spectra: lines 0.25 Hz apart, narrower than any valve's resonance.
SEGMENT = 4.0
#: s at first, doubled until it is the record: 200 ppm of drift over 40 s are 8 ms, less than a third of a
#: period at 40 Hz.
FIRST_PIECE = 40.0
#: s by which the coarse offset may be wrong: group delay of a response with 5 % of damping at 10 Hz.
COARSE_ERROR = 0.35
#: Natural frequencies (Hz) and damping ratios from which the search begins.
FREQUENCIES, DAMPINGS = np.geomspace(4.0, 80.0, 40), (0.05, 0.15, 0.4, 0.9)
#: Share of the best agreement that another offset may reach.
AMBIGUOUS = 0.97


#: s of the pieces in which the delay is fitted, and how many, spread evenly: the line through four has two
#: degrees of freedom left, by which its own scatter is known.
PIECE, PIECES = 15.0, 4
#: kg, of any spool: it scales forces alone.
MASS = 0.2
#: s: beyond the fit's own range the delay was not found.
LARGEST = 4.9e-3


def clock_offset(
    body: Array, body_period: float, spool: Array, spool_period: float, label: str
) -> ClockOffset:
    """Return offset and drift of the spool's clock from samples of both, shape (n,) each.

    Both begin at 0 of the channel's clock, in s; NaN where samples are missing. ``label`` is for messages.

    Raises:
        InputError: they have too little in common, or repeat themselves so that the offset is ambiguous.
    """
    rate = min(COMMON_RATE, 1.0 / body_period, 1.0 / spool_period)
    first, second = _common(body, body_period, rate), _common(spool, spool_period, rate)
    if min(first.size, second.size) < 4.0 * SEGMENT * rate:
        raise InputError(
            f"{label}: {min(first.size, second.size) / rate:.1f} s are too short to bring two clocks "
            "together: "
            f"record {4.0 * SEGMENT:g} s or more"
        )
    return _fine(first, second, rate, _coarse(first, second, rate, label), label)


def refined(
    found: ClockOffset, time: Array, body: Array, spool: Array, period: float, gaps: list[int]
) -> ClockOffset | None:
    """Return the offset with what samples that were aligned by it show to remain, shape (n,) each.

    ``None`` where fewer than two pieces can be fitted.
    """
    model, settings = load_model("coulomb"), FitSettings(fit_delay=True, noise_seconds=0.0, starts=1)
    stiffness = MASS * (2.0 * math.pi * found.natural_frequency) ** 2
    valve = Valve(id="any", moving_mass=MASS, spring_stiffness=stiffness)
    times, delays, deviations = [], [], []
    for begin, end in _pieces(time.size, period, gaps):
        one = fit([Record("aligned", 0, period, body[begin:end], spool[begin:end])], model, valve, settings)
        delay = next((number for number in one.parameters if number.name == SPOOL_DELAY), None)
        if (
            delay is None
            or not math.isfinite(delay.value + delay.standard_deviation)
            or abs(delay.value) > LARGEST
        ):
            continue
        times.append(float(time[begin:end].mean()))
        delays.append(delay.value)
        deviations.append(max(delay.standard_deviation, 1e-6))
    if len(times) < 2:
        return None
    # The scatter about the line, where larger, stands for the deviations.
    weight = 1.0 / np.array(deviations)
    design = np.column_stack([weight, weight * times])
    covariance = np.linalg.inv(design.T @ design)
    line = covariance @ (design.T @ (delays * weight))
    left = delays * weight - design @ line
    scatter = float(left @ left) / (len(times) - 2) if len(times) > 2 else 1.0
    stds = np.sqrt(np.diag(covariance) * max(1.0, scatter))
    return replace(
        found,
        offset=found.offset + float(line[0]),
        offset_std=float(stds[0]),
        drift=found.drift + float(line[1]),
        drift_std=float(stds[1]),
    )


def _common(row: Array, period: float, rate: float) -> Array:
    """Return a channel at ``rate`` by a cubic spline, limited to the band; what is missing is 0."""
    filled = np.where(np.isfinite(row), row, 0.0)
    filled -= filled.mean()
    low, high = BAND[0], min(BAND[1], 0.4 * rate)
    sections = signal.butter(4, (low, high), "bandpass", fs=1.0 / period, output="sos")
    filtered = signal.sosfiltfilt(sections, filled)
    times = np.arange(math.floor((row.size - 1) * period * rate) + 1) / rate
    return np.asarray(ndimage.map_coordinates(filtered, [times / period]))


def _coarse(first: Array, second: Array, rate: float, label: str) -> float:
    """Return the offset to within :data:`COARSE_ERROR`, by correlating windows with the other channel."""
    width = min(round(WINDOW * rate), first.size // 2)
    starts = np.unique(np.linspace(0, first.size - width, WINDOWS).astype(np.int64))
    size = fft.next_fast_len(second.size + width, real=True)
    spectrum = fft.rfft(second, size)
    energy = np.concatenate([[0.0], np.cumsum(np.square(second))])
    floor = 1e-3 * float(energy[-1]) / second.size * width
    span = np.arange(-(width - 1), second.size)
    local = energy[np.minimum(span + width, second.size)] - energy[np.maximum(span, 0)] + floor
    heights = np.zeros(first.size + second.size)
    for start in starts:
        window = first[start : start + width]
        power = float(window @ window)
        if power <= 0.0:
            continue
        product = np.conj(fft.rfft(window, size)) * spectrum
        # One-sided: the envelope does not care for the sign that a spool has beyond its resonance.
        envelope = np.abs(fft.ifft(np.concatenate([2.0 * product, np.zeros(size - product.size)])))
        found = np.concatenate([envelope[size - width + 1 :], envelope[: second.size]]) / np.sqrt(
            power * local
        )
        lags = span - int(start) + first.size
        inside = (lags >= 0) & (lags < heights.size)
        heights[lags[inside]] += found[inside]
    best = int(np.argmax(heights))
    away = np.abs(np.arange(heights.size) - best) > COARSE_ERROR * rate
    if float(heights[away].max(initial=0.0)) > AMBIGUOUS * float(heights[best]):
        other = int(np.argmax(np.where(away, heights, 0.0)))
        raise InputError(
            f"{label}: the motion repeats itself, so that the clocks could as well be "
            f"{abs(other - best) / rate:.3g} s "
            "further apart: record a start, a stop or a sweep with both, or sample both with one clock"
        )
    return (best - first.size) / rate


def _fine(first: Array, second: Array, rate: float, begin: float, label: str) -> ClockOffset:
    """Return offset and drift: on a piece first, then on ever longer ones."""
    overlap = (max(0.0, -begin), min(first.size / rate, second.size / rate - begin))
    if overlap[1] - overlap[0] < 4.0 * SEGMENT:
        raise InputError(
            f"{label}: body and spool overlap for {max(0.0, overlap[1] - overlap[0]):.1f} s only"
        )
    middle = _liveliest(first, rate, overlap)
    length, line = FIRST_PIECE, _Line(begin, 0.0)
    motion: _Motion | None = None
    while True:
        span = max(overlap[0], middle - 0.5 * length), min(overlap[1], middle + 0.5 * length)
        spectra = _spectra(first, second, rate, span, line)
        found = _adjusted(spectra, motion or _search(spectra, label), alike=True)
        line, motion = line.moved(found, spectra.middle), found.motion
        if span == overlap:
            break
        length *= 2.0
    # About the line that was found nothing is left to interpolate; dry friction damps each piece differently.
    spectra = _spectra(first, second, rate, overlap, line)
    alike, free = (_adjusted(spectra, motion, alike=one) for one in (True, False))
    if free.coherence < LIMITS.incoherent:
        raise InputError(
            f"{label}: body and spool have too little in common (coherence {free.coherence:.2f}) to "
            "bring their "
            "clocks together: are they of the same run?"
        )
    moved, other = line.moved(free, spectra.middle), line.moved(alike, spectra.middle)
    at_start = np.array([1.0, -spectra.middle])
    chance = math.sqrt(float(at_start @ free.covariance @ at_start)), math.sqrt(float(free.covariance[1, 1]))
    # What friction that damps alike everywhere would give tells how far the model can be trusted.
    return ClockOffset(
        moved.offset,
        math.hypot(chance[0], moved.offset - other.offset),
        moved.drift,
        math.hypot(chance[1], moved.drift - other.drift),
        free.coherence,
        free.motion.natural,
    )


@dataclass(frozen=True, slots=True)
class _Line:
    """Line of the spool's clock over the body's: offset (s) at 0, and drift."""

    offset: float
    drift: float

    def moved(self, found: _Adjusted, middle: float) -> _Line:
        """Return the line with what was found about it."""
        return _Line(self.offset + found.offset - found.drift * middle, self.drift + found.drift)


@dataclass(frozen=True, slots=True)
class _Motion:
    """Motion of the spool: gain of its sensor, natural frequency (Hz), damping ratio, delay (s)."""

    gain: float
    natural: float
    damping: float
    delay: float = 0.0


@dataclass(frozen=True, slots=True)
class _Adjusted:
    """Adjusted offset (s, at the middle of the times) and drift, their covariance, motion and coherence."""

    offset: float
    drift: float
    covariance: Array
    motion: _Motion
    coherence: float


def _liveliest(row: Array, rate: float, overlap: tuple[float, float]) -> float:
    """Return the middle of the piece of :data:`FIRST_PIECE` s that has the most power within ``overlap``."""
    low, high = round(overlap[0] * rate), round(overlap[1] * rate)
    width = min(round(FIRST_PIECE * rate), high - low)
    total = np.concatenate([[0.0], np.cumsum(np.square(row[low:high]))])
    power = total[width:] - total[:-width]
    return (low + int(np.argmax(power)) + 0.5 * width) / rate


@dataclass(frozen=True, slots=True)
class _Spectra:
    """Spectra of blocks, shape (k, f); ``times`` (k,) of their middles from the body's first sample, s."""

    frequency: Array
    times: Array
    middle: float
    body: Array
    spool: Array
    cross: Complex


def _spectra(first: Array, second: Array, rate: float, span: tuple[float, float], line: _Line) -> _Spectra:
    """Return cross-spectra of segments, the spool taken at the body's times by the line known so far."""
    size = round(SEGMENT * rate)
    step = size // 2
    low = round(span[0] * rate)
    count = max(1, (round(span[1] * rate) - low - size) // step + 1)
    window = signal.windows.hann(size, sym=False)
    frequency = np.asarray(fft.rfftfreq(size, 1.0 / rate))
    inside = (frequency >= BAND[0]) & (frequency <= min(BAND[1], 0.4 * rate))
    rows: list[tuple[float, Array, Array, Complex]] = []
    for at in range(low, low + count * step, step):
        if at + size > first.size:
            break
        middle = (at + 0.5 * size) / rate
        place = (at / rate + line.offset + line.drift * middle) * rate
        begin = math.floor(place)
        if begin < 0 or begin + size > second.size:
            continue
        one = fft.rfft(window * first[at : at + size])[inside]
        other = fft.rfft(window * second[begin : begin + size])[inside]
        # The rest of a sample as a phase; no value is interpolated.
        other = other * np.exp(2j * np.pi * frequency[inside] * (place - begin) / rate)
        rows.append((middle, np.abs(one) ** 2, np.abs(other) ** 2, np.conj(one) * other))
    # Some 40 blocks at most are enough for a line, and each is the mean of several segments.
    each = max(1, math.ceil(len(rows) / 40))
    blocks = [rows[at : at + each] for at in range(0, len(rows), each)]
    times = np.array([np.mean([row[0] for row in block]) for block in blocks])
    body, spool, cross = (
        np.array([sum(row[column] for row in block) / len(block) for block in blocks]) for column in (1, 2, 3)
    )
    return _Spectra(frequency[inside], times, float(times.mean()), body, spool, cross)


def _search(spectra: _Spectra, label: str) -> _Motion:
    """Return the motion and delay from which the adjustment begins."""
    cross, body = spectra.cross.sum(axis=0), spectra.body.sum(axis=0)
    delays = np.arange(-COARSE_ERROR, COARSE_ERROR, 0.5e-3)
    turns = np.exp(2j * np.pi * np.outer(delays, spectra.frequency))
    # Phases alone, each line by its coherence: not the power that a resonance or a sweep happens to put
    # there.
    common = cross / np.sqrt(np.maximum(body * spectra.spool.sum(axis=0), 1e-300))
    best, found = 0.0, None
    for natural in FREQUENCIES:
        for damping in DAMPINGS:
            response = _response(spectra.frequency, natural, np.array([damping]))[0]
            score = (turns @ (common * np.conj(response) / np.abs(response))).real
            at = int(np.argmax(score))
            if float(score[at]) > best:
                best, found = float(score[at]), _Motion(1.0, float(natural), damping, float(delays[at]))
    if found is None:
        raise InputError(f"{label}: nothing moves in them, so that their clocks cannot be brought together")
    return found


def _response(frequency: Array, natural: float, damping: Array) -> Complex:
    """Return a spring-held mass's acceleration over its base's, (k, f) for ``damping`` (k,)."""
    ratio = frequency / natural
    damped = 2j * damping[:, np.newaxis] * ratio
    return np.asarray((1.0 + damped) / (1.0 - ratio**2 + damped))


def _adjusted(spectra: _Spectra, begin: _Motion, *, alike: bool) -> _Adjusted:
    """Return offset, drift and motion by least squares; damping ``alike`` everywhere, or of each block."""
    frequency, lags = spectra.frequency, spectra.times - spectra.middle
    count = 1 if alike else lags.size
    start = np.array([begin.gain, begin.natural, begin.delay, 0.0, *np.full(count, begin.damping)])

    def model(parameters: Array) -> Complex:
        gain, natural, offset, drift = parameters[:4]
        response = gain * _response(frequency, natural, parameters[4:])
        return np.asarray(response * np.exp(-2j * np.pi * np.outer(offset + drift * lags, frequency)))

    coherent = _coherence(spectra, model(start))
    noise = np.maximum(spectra.body * spectra.spool.mean(axis=0) * (1.0 - coherent), 1e-300)
    weight = np.sqrt(coherent / (noise + 1e-6 * float(noise.max())))

    def residuals(parameters: Array) -> Array:
        error = (spectra.cross - model(parameters) * spectra.body) * weight
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    scale = np.array([1.0, 10.0, 1e-3, 1e-5, *np.full(count, 0.2)])
    low = np.array([1e-2, 1.0, -1.0, -2e-3, *np.full(count, 1e-3)])
    high = np.array([1e2, 200.0, 1.0, 2e-3, *np.full(count, 5.0)])
    fitted = optimize.least_squares(
        residuals, np.clip(start, low, high), bounds=(low, high), x_scale=scale, loss="soft_l1", max_nfev=60
    )
    jacobian = np.asarray(fitted.jac) * scale
    # Neighbouring lines of a Hann window, and segments that overlap by half, share what they tell: 1.5 times
    # 1.9 as many numbers as there are independent ones (Welch 1967).
    variance = 2.8 * 2.0 * float(fitted.cost) / max(1, jacobian.shape[0] - scale.size)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian) * np.outer(scale, scale)
    found = fitted.x
    motion = _Motion(float(found[0]), float(found[1]), float(np.median(found[4:])))
    power = np.sqrt(spectra.body.sum(axis=0) * spectra.spool.sum(axis=0))
    coherence = float(np.sum(_coherence(spectra, model(found)) * power) / max(float(np.sum(power)), 1e-300))
    return _Adjusted(float(found[2]), float(found[3]), np.asarray(covariance[2:4, 2:4]), motion, coherence)


def _coherence(spectra: _Spectra, model: Complex) -> Array:
    """Return the squared coherence of both channels, (f,), the phase of ``model`` taken off."""
    smooth = np.ones(5) / 5.0
    one, other = (np.convolve(row.sum(axis=0), smooth, "same") for row in (spectra.body, spectra.spool))
    turned = (spectra.cross * np.exp(-1j * np.angle(model))).sum(axis=0).real
    joint = np.convolve(turned, smooth, "same")
    squared = np.clip(joint, 0.0, None) ** 2 / np.maximum(one * other, 1e-300)
    return np.asarray(np.minimum(squared, 0.999))


def _pieces(size: int, period: float, gaps: list[int]) -> list[tuple[int, int]]:
    """Return up to :data:`PIECES` stretches without gaps, spread evenly."""
    width = min(round(PIECE / period), size // PIECES)
    if width * period < 0.5 * PIECE:
        return []
    inside = [
        (int(start), int(start) + width)
        for start in np.linspace(0, size - width, PIECES).astype(np.int64)
        if not any(start < gap < start + width for gap in gaps)
    ]
    return list(dict.fromkeys(inside))
