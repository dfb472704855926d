"""Nuisances of the measuring chain that a record shows without any model: spikes, hum, drift of the zero."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from spool_core.numbers import Array, Complex
from spool_core.record_limits import LIMITS
from spool_sim.valve import Valve

from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase, noise_of

#: Samples of a spike at most, and samples on each side that predict those between: a cubic through them.
WIDEST, BESIDE = 3, 2
#: Deviations from which a sample is far off: noise of any band exceeds it in one of 1e15 samples, sharp
#: changes of a force are shared by the neighbours.
FAR, NEAR = 8.0, 4.0
#: Share of how far a spike is off both sides by which it is off either of them at least: half way from the
#: bend where a blow begins (0) to a spike (1).
BEND = 0.5
#: s over which the deviation is taken.
SPIKE_AROUND = 0.25
#: Samples that may be spikes, as a share: more are another disease.
MOST_SPIKES = 0.02
#: Standard deviations of the mean rank of travel or speed from which they are of the motion, and how few of
#: the spool's could show that.
AS_HITS, FEWEST_SPIKES = 3.0, 5
#: Hz, from which on travel is looked at for that.
TRAVEL = 2.0


#: Hz, of the mains of the world, and how far they stray from it together with a logger's clock, relative
#: (EN 50160: 1 % at most; 0.2 % in practice, and 0.01 % of the clock).
MAINS, STRAY = (50.0, 60.0), 2e-3
#: Harmonics of which one stands out where there is hum: of rectifiers and saturated transformers.
HARMONICS = 8
#: s of a piece, and share of it after which the next one begins.
HUM_PIECE, HOP = 0.5, 0.25
#: Hz on both sides of a line whose lines it is compared with: within the pass band of a piece.
HUM_AROUND = 1.5
#: Power of a line over the mean of its neighbourhood: noise exceeds it in one of 5e8 lines (exponential
#: distribution), some thousand of which are looked at in each record.
HUM_SIGNIFICANT = 20.0
#: Power of a line over the strongest one near it: those of a multisine, or of an engine, have neighbours.
ALONE = 4.0
#: Share by which lines of the two channels may differ from what motion leaves between them, by the transfer
#: at the neighbouring frequencies; factor by which by the valve's description, where there is no motion.
AS_MOTION, AS_DESCRIBED = 0.3, 4.0

#: s of the means that show a drift, and their number at least.
DRIFT_PIECE, DRIFT_FEWEST = 2.0, 5
#: Standard deviations that the course of the means must exceed: noise does in one of 1e9 records.
DRIFT_SIGNIFICANT = 6.0
#: Share of a channel's rms below which a drift changes nothing that is analysed: the analysis' own band
#: begins above it, and two right simulations differ by half as much.
MATTERS = 1e-3


@dataclass(frozen=True, slots=True)
class Cleaned:
    """Records freed of a nuisance, and what was found.

    Attributes:
        records: as many as were given, of the same lengths.
        found: in which channels, and how large.
    """

    records: tuple[Record, ...]
    found: tuple[Nuisance, ...] = ()


class RecordNuisance(ABC):
    """Nuisance that is found in the readings themselves; ``id`` is its name in results."""

    id: ClassVar[str]

    @abstractmethod
    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:
        """Return ``records`` of ``valve`` without it, and what was found; as given where there is none."""


@dataclass(frozen=True, slots=True)
class Nuisance:
    """Fault of the measuring chain that was found: no part of the valve, and never of the verdict.

    Attributes:
        id: of its kind.
        channel: ``body``, ``spool`` or ``both``.
        size: how large it is, in ``unit``, with its standard deviation ``std`` (NaN where that is not known).
        corrected: it is left out of what is compared.
        check: what to look at on the measuring chain.
    """

    id: str
    channel: str
    size: float
    std: float
    unit: str
    corrected: bool
    check: str


class Spikes(RecordNuisance):
    """Few wrong samples in either or both channels: replaced by what their neighbours predict."""

    id = "spikes"
    check = "plugs and cables (contact), electromagnetic interference by switched valves, the logger's link"

    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:  # noqa: ARG002
        """Return ``records`` without spikes, and how many a second each channel has."""
        seconds = sum(record.duration for record in records)
        freed = {
            name: [_freed(getattr(record, name), record.sample_rate) for record in records]
            for name in ("body", "spool")
        }
        # Of all stretches together: a pause may leave few in each.
        rows = zip(records, freed["body"], freed["spool"], strict=True)
        if _of_motion(np.concatenate([_ranks(one, body[0], *spool) for one, body, spool in rows], axis=1)):
            nowhere = np.empty(0, dtype=np.int64)
            freed["spool"] = [(record.spool, nowhere) for record in records]
        counts = {name: sum(places.size for _, places in own) for name, own in freed.items()}
        rate = {name: count / seconds for name, count in counts.items() if count}
        cleaned = [
            replace(record, body=body, spool=spool)
            for record, (body, _), (spool, _) in zip(records, freed["body"], freed["spool"], strict=True)
        ]
        found = tuple(
            Nuisance(
                self.id, name, value, float(np.sqrt(value / seconds)), "1/s", corrected=True, check=self.check
            )
            for name, value in sorted(rate.items())
        )
        return Cleaned(tuple(cleaned) if found else tuple(records), found)


def spikes_of(row: Array, rate: float) -> list[tuple[int, int]]:
    """Return first sample and width of each spike in ``row`` (n,), which comes at ``rate`` (Hz).

    Where a blow begins or ends the sample at the bend is off a curve through both sides, but not off the line
    through the two samples on one of them: that is no spike.
    """
    found: list[tuple[int, int]] = []
    taken = np.zeros(row.size, dtype=bool)
    off = {width: _off(row, width) for width in range(1, WIDEST + 1)}
    deviation = {width: _deviation(rows, row, rate) for width, rows in off.items()}
    for width in range(1, WIDEST + 1):
        least = np.min(np.abs(off[width]), axis=0)
        aside = np.abs(off[width].sum(axis=0)) >= np.abs(off[width]).sum(axis=0)
        bend = _off_a_side(row, width) < BEND * least
        for place in np.flatnonzero((least > FAR * deviation[width]) & aside & ~bend).tolist():
            part = slice(max(0, place - 4), place + width + 4)
            if taken[part].any() or least[place] < least[part].max():
                continue
            corrected = row[part].copy()
            inner = slice(place - part.start, place - part.start + width)
            corrected[inner] -= off[width][:, place]
            rest = np.abs(_off(corrected, 1)[0])
            if rest[BESIDE:-BESIDE].max(initial=0.0) < NEAR * deviation[1][place]:
                found.append((place, width))
                taken[place : place + width] = True
    return sorted(found)


class Hum(RecordNuisance):
    """Mains hum on either or both channels: lines at the mains' frequency and its harmonics.

    A line is looked for in the complex envelope of a channel at each harmonic, cut into overlapping pieces
    whose strong ones count no more than the median: a sweep that passes moves few of them, a line that lasts
    all. The spool's motion, by the transfer at the frequencies on both sides, is taken off first: a line that
    is left is none of the motion.
    """

    id = "hum"
    check = (
        "grounding and shields of the sensors' cables, ground loops, the supply of the amplifiers; a motor "
        "at the mains' frequency that acts on the spool alone would look alike"
    )

    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:
        """Return ``records`` without mains hum, and its amplitude in each channel."""
        largest: dict[str, _Line] = {}
        cleaned = []
        for record in records:
            rows = {"body": record.body, "spool": record.spool}
            for name, line in _hum(record, valve):
                time = np.arange(record.body.size) * record.sample_period
                turned = np.exp(2j * np.pi * line.frequency * time)
                rows[name] = rows[name] - (line.amplitude * turned).real
                if name not in largest or abs(line.amplitude) > abs(largest[name].amplitude):
                    largest[name] = line
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        found = tuple(
            Nuisance(
                self.id, name, abs(line.amplitude), line.deviation, "m/s^2", corrected=True, check=self.check
            )
            for name, line in sorted(largest.items())
        )
        return Cleaned(tuple(cleaned) if found else tuple(records), found)


def frequencies_of_hum(record: Record, valve: Valve) -> tuple[float, ...]:
    """Return the frequencies (Hz) of ``record`` at which mains hum is, whether it stands out there or not.

    Hum is periodic: where one harmonic stands out, the others are there as well, each as strong as it likes.
    """
    mains = {line.fundamental for _, line in _hum(record, valve)}
    highest = _highest(record)
    return tuple(sorted(line * order for line in mains for order in range(1, int(highest / line) + 1)))


class BiasDrift(RecordNuisance):
    """Zero that wanders: a straight line through the means of either channel, taken off with the bias."""

    id = "bias_drift"
    check = "temperature of sensor and amplifier, warm-up time, a charge amplifier's reset, cable movement"

    def clean(self, records: Sequence[Record], valve: Valve) -> Cleaned:  # noqa: ARG002
        """Return ``records`` without bias and drift, and how far each zero drifts."""
        found: dict[str, Nuisance] = {}
        cleaned = []
        for record in records:
            rows = {"body": record.body, "spool": record.spool}
            noise = noise_of(record.body, record.spool, record.sample_rate)
            for name, density in (("body", noise.body), ("spool", noise.spool)):
                row = getattr(record, name)
                line, far = drift_of(row, record.sample_period, density)
                if far is None:
                    continue
                rows[name] = row - line
                size = float(abs(line[-1] - line[0]))
                if size > MATTERS * float(row.std()) and (name not in found or size > found[name].size):
                    found[name] = Nuisance(
                        self.id, name, size, far, "m/s^2", corrected=True, check=self.check
                    )
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        ordered = tuple(found[name] for name in sorted(found))
        return Cleaned(tuple(cleaned) if found else tuple(records), ordered)


def drift_of(row: Array, period: float, density: float) -> tuple[Array, float | None]:
    """Return the straight line through ``row`` (n,), and the deviation of its rise; ``None`` without a drift.

    Args:
        row: readings, a sample every ``period`` s.
        density: of the channel's noise at least, unit^2/Hz.
    """
    length = round(DRIFT_PIECE / period)
    count = row.size // length
    if count < DRIFT_FEWEST:
        return np.zeros(row.size), None
    window = np.hanning(length)
    means = row[: count * length].reshape(count, length) @ (window / window.sum())
    time = (np.arange(count) + 0.5) * length
    slope, start = np.polyfit(time, means, 1)
    scatter = float(np.std(means - (start + slope * time), ddof=2))
    white = float(np.sqrt(0.5 * density / period * np.sum((window / window.sum()) ** 2)))
    deviation = max(scatter, white) * row.size / (length * np.sqrt(count**3 / 12.0))
    rise = slope * row.size
    if abs(rise) < DRIFT_SIGNIFICANT * deviation:
        return np.zeros(row.size), None
    return start + slope * np.arange(row.size), deviation


def _off(row: Array, width: int) -> Array:
    """Return by how much ``width`` samples from each one on are off what is predicted, shape (width, n)."""
    beside = np.array([*range(-BESIDE, 0), *range(width, width + BESIDE)])
    off = np.zeros((width, row.size))
    last = row.size - width - BESIDE
    for place in range(width):
        # Lagrange's polynomial through the samples beside.
        weights = [np.prod([(place - m) / (k - m) for m in beside if m != k]) for k in beside]
        for weight, offset in zip(weights, beside.tolist(), strict=True):
            off[place, BESIDE:last] -= weight * row[BESIDE + offset : last + offset]
        off[place, BESIDE:last] += row[BESIDE + place : last + place]
    return off


def _off_a_side(row: Array, width: int) -> Array:
    """Return by how much ``width`` samples from each one on are off the line before or behind them, (n,)."""
    ahead = np.full(row.size, np.inf)
    ahead[2:] = np.abs(row[2:] - 2.0 * row[1:-1] + row[:-2])
    behind = np.full(row.size, np.inf)
    last = row.size - width - 1
    behind[:last] = np.abs(row[width - 1 : -2] - 2.0 * row[width:-1] + row[width + 1 :])[:last]
    return np.asarray(np.minimum(ahead, behind))


def _deviation(off: Array, row: Array, rate: float) -> Array:
    """Return the deviation of ``off`` (w, n) around each sample, shape (n,), of its largest sample."""
    width = max(16, round(SPIKE_AROUND * rate))
    largest = np.abs(off).max(axis=0)
    blocks = -(-largest.size // width)
    padded = np.concatenate([largest, largest[::-1][: blocks * width - largest.size]])
    middle = np.median(padded.reshape(blocks, -1), axis=1) / 0.6745
    # Calm stretches next to lively ones: the larger deviation counts.
    deviation = np.repeat(ndimage.maximum_filter1d(middle, 3), width)[: largest.size]
    return np.asarray(np.maximum(deviation, 1e-9 * float(np.abs(row).max(initial=0.0)) + 1e-30))


def _freed(row: Array, rate: float) -> tuple[Array, NDArray[np.int64]]:
    """Return ``row`` (n,) with cubics through the samples beside its spikes, and where these are."""
    row = _ended(row, rate)
    spikes = spikes_of(row, rate)
    if not 0 < len(spikes) < MOST_SPIKES * row.size:
        return row, np.empty(0, dtype=np.int64)
    off = {width: _off(row, width) for width in {width for _, width in spikes}}
    freed = row.copy()
    for place, width in spikes:
        freed[place : place + width] -= off[width][:, place]
    return freed, np.array([place for place, _ in spikes], dtype=np.int64)


def _ended(row: Array, rate: float) -> Array:
    """Return ``row`` (n,) without spikes at its ends, which one side alone shows."""
    found = row.copy()
    for view in (found, found[::-1]):
        bends = np.abs(np.diff(view[-max(16, round(SPIKE_AROUND * rate)) :], 2))
        far = np.flatnonzero(bends[-WIDEST:] > FAR * float(np.median(bends)) / 0.6745)
        if far.size:
            begin = far[0] - min(WIDEST, bends.size)
            view[begin:] = view[begin - 1]
    return found


def _ranks(record: Record, body: Array, spool: Array, places: NDArray[np.int64]) -> Array:
    """Return the ranks (0 to 1) of abs(z') and abs(z) at ``places``, shape (2, spikes).

    The motion is that of the readings without spikes, which are no motion.
    """
    band = ZeroPhase(record.sample_period, TRAVEL)
    rows = [np.abs(band.apply(spool - body, order)) for order in (1, 2)]
    return np.array([np.searchsorted(np.sort(row), row[places]) / row.size for row in rows])


def _of_motion(ranks: Array) -> bool:
    """Whether spikes of ``ranks`` (2, spikes) may be hits, or jumps of friction.

    Those come at places or speeds of the motion.
    """
    count = ranks.shape[1]
    if count < FEWEST_SPIKES:
        return True
    return bool(np.any(np.abs(ranks.mean(axis=1) - 0.5) > AS_HITS / np.sqrt(12.0 * count)))


@dataclass(frozen=True, slots=True)
class _Line:
    """Hum in one channel: its frequency, Hz, complex amplitude (m/s^2) and standard deviation of that.

    ``fundamental`` is the frequency of the mains, Hz, of which this line is a multiple.
    """

    frequency: float
    amplitude: complex
    deviation: float
    fundamental: float = 0.0


def _hum(record: Record, valve: Valve) -> list[tuple[str, _Line]]:
    """Return the channel and line of each harmonic of the mains that is none of the motion."""
    found: list[tuple[str, _Line]] = []
    for mains in MAINS:
        known = 0.0
        lines: list[tuple[str, _Line]] = []
        for harmonic in itertools.count(1):
            # Harmonics stand at multiples of the frequency that the first line has, and share its error.
            centre = (known or mains) * harmonic
            stray = (0.0 if known else STRAY * mains) + (0.6 + 0.3 * harmonic) / record.duration
            if centre > _highest(record) or (harmonic > HARMONICS and not known):
                break
            here = _lines(record, valve, centre, stray)
            lines += here.items()
            if here and not known:
                known = next(iter(here.values())).frequency / harmonic
        found += [(name, replace(line, fundamental=known)) for name, line in lines]
    return found


def _highest(record: Record) -> float:
    """Return the highest frequency at which hum can be told in ``record``, Hz; 0 in a brief one."""
    return 0.45 * record.sample_rate - HUM_AROUND if record.duration >= 16.0 * HUM_PIECE else 0.0


def _lines(record: Record, valve: Valve, frequency: float, stray: float) -> dict[str, _Line]:
    """Return the lines within ``stray`` of ``frequency`` (Hz) that are no motion, by channel."""
    body, spool = (_envelope(row, record, frequency) for row in (record.body, record.spool))
    ratio, coherence = _transfer(body, spool, stray)
    described = coherence < LIMITS.coherent
    if described:
        turn = 2j * np.pi * frequency
        force = valve.spring_stiffness + valve.likely_viscous_coefficient * turn
        ratio = complex(force / (force + valve.moving_mass * turn**2))
    rows = {"body": body, "spool": spool}
    left = _line(spool - ratio * body, frequency, 0.0, stray)
    if left is None:
        return {}
    at = left.frequency - frequency
    own = {name: line for name, row in rows.items() if (line := _line(row, frequency, at, 0.0)) is not None}
    if "body" in own:
        moved = ratio * own["body"].amplitude
        if abs(left.amplitude) < AS_MOTION * abs(moved):
            return {}
        if described and "spool" in own:
            share = abs(own["spool"].amplitude) / abs(moved)
            if 1.0 / AS_DESCRIBED < share < AS_DESCRIBED:
                return {}
        if abs(left.amplitude + moved) < max(AS_MOTION * abs(moved), 3.0 * left.deviation):
            # The spool does not follow the body's line: that one alone is none of the motion.
            return {"body": own["body"]}
    return own or {"spool": left}


def _transfer(body: Complex, spool: Complex, stray: float) -> tuple[complex, float]:
    """Return the spool's envelope over the body's, and their coherence, at the frequencies on both sides."""
    lines = [np.fft.fft(row * np.hanning(row.size)) for row in (body, spool)]
    offset = np.abs(np.fft.fftfreq(body.size, HUM_PIECE * HOP))
    beside = (offset > stray + 3.0 / (body.size * HUM_PIECE * HOP)) & (offset < HUM_AROUND)
    first, second = (row[beside] for row in lines)
    powers = [float(np.sum(np.abs(row) ** 2)) for row in (first, second)]
    if min(powers) <= 0.0:
        return 0.0, 0.0
    cross = complex(np.vdot(first, second))
    return cross / powers[0], abs(cross) ** 2 / (powers[0] * powers[1])


def _envelope(row: Array, record: Record, frequency: float) -> Complex:
    """Return the complex amplitude of ``row`` (n,) at ``frequency`` in overlapping pieces, shape (p,)."""
    length = 8 * round(HUM_PIECE * record.sample_rate / 8)
    turned = row * np.exp(-2j * np.pi * frequency * np.arange(row.size) * record.sample_period)
    window = np.hanning(length)
    total = np.lib.stride_tricks.sliding_window_view(turned, length)[:: round(HOP * length)]
    return np.asarray(total @ (2.0 * window / window.sum()))


def _line(envelope: Complex, frequency: float, centre: float, stray: float) -> _Line | None:
    """Return the line in ``envelope``, taken at ``frequency``, at ``centre`` off that to within ``stray``."""
    step = HUM_PIECE * HOP
    size = np.abs(envelope)
    middle = float(np.median(size))
    if middle <= 0.0:
        return None
    even = envelope * np.minimum(1.0, middle / np.maximum(size, 1e-30))
    power = np.abs(np.fft.fft(even * np.hanning(even.size), 4 * even.size)) ** 2
    offset = np.fft.fftfreq(power.size, step)
    width = 1.0 / (even.size * step)
    far = np.abs(offset - centre)
    near = far <= max(stray, 0.6 * width)
    around = (far > max(stray, 0.6 * width) + 3.0 * width) & (far < HUM_AROUND)
    if not around.any():
        return None
    best = int(np.flatnonzero(near)[np.argmax(power[near])])
    # The mean of exponentially distributed power, by its median, which other lines do not move.
    noise = float(np.median(power[around])) / np.log(2.0)
    if power[best] < max(HUM_SIGNIFICANT * noise, ALONE * float(power[around].max())):
        return None
    # The peak lies where that of a parabola in dB does.
    left, peak, right = np.log(np.maximum(power[[best - 1, best, (best + 1) % power.size]], 1e-300))
    curve = left - 2.0 * peak + right
    beside = float(0.5 * (left - right) / curve) if curve < 0.0 else 0.0
    shift = float(offset[best]) + beside * float(offset[1])
    turned = envelope * np.exp(-2j * np.pi * shift * step * np.arange(envelope.size))
    amplitude = complex(np.median(turned.real), np.median(turned.imag))
    deviation = float(np.sqrt(noise)) / float(np.sum(np.hanning(even.size)))
    # A piece stands for its middle.
    amplitude *= complex(np.exp(-1j * np.pi * shift * HUM_PIECE))
    return _Line(frequency + shift, amplitude, deviation)
