"""Mains hum: lines at the mains' frequency and its harmonics that no motion explains.

A line is looked for in the complex envelope of a channel at each harmonic, cut into overlapping pieces whose
strong ones count no more than the median: a sweep that passes moves few of them, a line that lasts all. The
spool's motion, by the transfer at the frequencies on both sides, is taken off first: a line that is left is
none of the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from spool_core.numbers import Array
from spool_sim.valve import Valve

from spool_estimator.identification.nuisances.record_nuisance import Nuisance
from spool_estimator.identification.record import Record

from .record_nuisance import Cleaned, RecordNuisance

Complex = NDArray[np.complex128]

#: Hz, of the mains of the world, and how far they stray from it together with a logger's clock, relative
#: (EN 50160: 1 % at most; 0.2 % in practice, and 0.01 % of the clock).
MAINS, STRAY = (50.0, 60.0), 2e-3
#: Harmonics that are looked at: of rectifiers and saturated transformers.
HARMONICS = 8
#: s of a piece, and share of it after which the next one begins.
PIECE, HOP = 0.5, 0.25
#: Hz on both sides of a line whose lines it is compared with: within the pass band of a piece.
AROUND = 1.5
#: Power of a line over the mean of its neighbourhood: noise exceeds it in one of 5e8 lines (exponential
#: distribution), some thousand of which are looked at in each record.
SIGNIFICANT = 20.0
#: Power of a line over the strongest one near it: those of a multisine, or of an engine, have neighbours.
ALONE = 4.0
#: Share by which lines of the two channels may differ from what motion leaves between them, by the transfer
#: at the neighbouring frequencies; factor by which by the valve's description, where there is no motion.
AS_MOTION, AS_DESCRIBED = 0.3, 4.0
#: Squared coherence from which the neighbouring frequencies show motion.
COHERENT = 0.5


@dataclass(frozen=True, slots=True)
class _Line:
    """Line of one channel: its frequency, Hz, complex amplitude (m/s^2) and standard deviation of that."""

    frequency: float
    amplitude: complex
    deviation: float


class Hum(RecordNuisance):
    """Mains hum on either or both channels."""

    id = "hum"
    order = 1
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
                rows[name] = rows[name] - _wave(line, record)
                if name not in largest or abs(line.amplitude) > abs(largest[name].amplitude):
                    largest[name] = line
            cleaned.append(replace(record, body=rows["body"], spool=rows["spool"]))
        found = tuple(
            Nuisance(self.id, name, abs(line.amplitude), "m/s^2", self.check, line.deviation, corrected=True)
            for name, line in sorted(largest.items())
        )
        return Cleaned(tuple(cleaned) if found else tuple(records), found)


def frequencies_of_hum(record: Record, valve: Valve) -> tuple[float, ...]:
    """Return the frequencies (Hz) of the lines of either channel of ``record`` that are mains hum."""
    return tuple(sorted({line.frequency for _, line in _hum(record, valve)}))


def _hum(record: Record, valve: Valve) -> list[tuple[str, _Line]]:
    """Return the channel and line of each harmonic of the mains that is none of the motion."""
    found: list[tuple[str, _Line]] = []
    for mains in MAINS:
        known = 0.0
        for harmonic in range(1, HARMONICS + 1):
            # Harmonics stand at multiples of the frequency that the first line has, and share its error.
            centre = (known or mains) * harmonic
            stray = (0.0 if known else STRAY * mains) + (0.6 + 0.3 * harmonic) / record.duration
            if centre + AROUND > 0.45 * record.sample_rate or record.duration < 16.0 * PIECE:
                break
            lines = _lines(record, valve, centre, stray)
            found += lines.items()
            if lines and not known:
                known = next(iter(lines.values())).frequency / harmonic
    return found


def _wave(line: _Line, record: Record) -> Array:
    time = np.arange(record.body.size) * record.sample_period
    return np.asarray((line.amplitude * np.exp(2j * np.pi * line.frequency * time)).real)


def _lines(record: Record, valve: Valve, frequency: float, stray: float) -> dict[str, _Line]:
    """Return the lines within ``stray`` of ``frequency`` (Hz) that are no motion, by channel."""
    body, spool = (_envelope(row, record, frequency) for row in (record.body, record.spool))
    ratio, coherence = _transfer(body, spool, stray)
    described = coherence < COHERENT
    if described:
        ratio = _described(frequency, valve)
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


def _described(frequency: float, valve: Valve) -> complex:
    """Return spool over body at ``frequency`` (Hz) by the valve's description."""
    turn = 2j * np.pi * frequency
    force = valve.spring_stiffness + valve.likely_viscous_coefficient * turn
    return complex(force / (force + valve.moving_mass * turn**2))


def _transfer(body: Complex, spool: Complex, stray: float) -> tuple[complex, float]:
    """Return the spool's envelope over the body's, and their coherence, at the frequencies on both sides."""
    lines = [np.fft.fft(row * np.hanning(row.size)) for row in (body, spool)]
    offset = np.abs(np.fft.fftfreq(body.size, PIECE * HOP))
    beside = (offset > stray + 3.0 / (body.size * PIECE * HOP)) & (offset < AROUND)
    first, second = (row[beside] for row in lines)
    powers = [float(np.sum(np.abs(row) ** 2)) for row in (first, second)]
    if min(powers) <= 0.0:
        return 0.0, 0.0
    cross = complex(np.vdot(first, second))
    return cross / powers[0], abs(cross) ** 2 / (powers[0] * powers[1])


def _envelope(row: Array, record: Record, frequency: float) -> Complex:
    """Return the complex amplitude of ``row`` (n,) at ``frequency`` in overlapping pieces, shape (p,)."""
    length = 8 * round(PIECE * record.sample_rate / 8)
    turned = row * np.exp(-2j * np.pi * frequency * np.arange(row.size) * record.sample_period)
    window = np.hanning(length)
    total = np.lib.stride_tricks.sliding_window_view(turned, length)[:: round(HOP * length)]
    return np.asarray(total @ (2.0 * window / window.sum()))


def _line(envelope: Complex, frequency: float, centre: float, stray: float) -> _Line | None:
    """Return the line in ``envelope``, taken at ``frequency``, at ``centre`` off that to within ``stray``."""
    step = PIECE * HOP
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
    around = (far > max(stray, 0.6 * width) + 3.0 * width) & (far < AROUND)
    if not around.any():
        return None
    best = int(np.flatnonzero(near)[np.argmax(power[near])])
    # The mean of exponentially distributed power, by its median, which other lines do not move.
    noise = float(np.median(power[around])) / np.log(2.0)
    if power[best] < max(SIGNIFICANT * noise, ALONE * float(power[around].max())):
        return None
    shift = float(offset[best]) + _between(power, best) * float(offset[1])
    turned = envelope * np.exp(-2j * np.pi * shift * step * np.arange(envelope.size))
    amplitude = complex(np.median(turned.real), np.median(turned.imag))
    deviation = float(np.sqrt(noise)) / float(np.sum(np.hanning(even.size)))
    # A piece stands for its middle.
    amplitude *= complex(np.exp(-1j * np.pi * shift * PIECE))
    return _Line(frequency + shift, amplitude, deviation)


def _between(power: Array, best: int) -> float:
    """Return how far from the line ``best`` the peak of ``power`` is, in lines: that of a parabola in dB."""
    left, middle, right = np.log(np.maximum(power[[best - 1, best, (best + 1) % power.size]], 1e-300))
    curve = left - 2.0 * middle + right
    return float(0.5 * (left - right) / curve) if curve < 0.0 else 0.0
