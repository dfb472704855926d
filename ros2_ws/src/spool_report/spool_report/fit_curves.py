"""Curves that the pictures of a fit show, as arrays: waveforms, friction over velocity, spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_estimator.identification.fit_result import SPOOL_DELAY, SPOOL_GAIN, Fit
from spool_estimator.identification.free_run import USUAL, FreeRun, Reading, Response
from spool_estimator.identification.record import Record, first_seconds
from spool_estimator.identification.spectra import ZeroPhase, density_of, relative_motion
from spool_sim.observation import Observation
from spool_sim.valve import Valve

#: s of data that pictures are made from at most, and of a window of a free run.
LONGEST, WINDOW = 60.0, 4.0
#: Bins of velocity, samples in each at least, and samples of the measured friction that are drawn.
BINS, LEAST, POINTS = 41, 10, 4000
#: Hz, of the conditioning.
LOW_CUT = 3.0
#: Hz, the frequency of the paper's figure 13.
PAPER_FREQUENCY = 60.0
#: Periods shown of a waveform, and s over which a frequency is looked for.
PERIODS, LOOK = 4.0, 0.5
#: Share of the body's power around a frequency that makes an excerpt one of that frequency.
ONE_FREQUENCY = 0.5


@dataclass(frozen=True, slots=True)
class Excerpt:
    """Excerpt of a recording that is worth looking at.

    Attributes:
        title: why.
        window: number of the free run's window.
        first, stop: samples in it, ``stop`` exclusive.
        start: s since the first sample of the recording.
    """

    title: str
    window: int
    first: int
    stop: int
    start: float


@dataclass(frozen=True, slots=True)
class FrictionCurve:
    """Friction over velocity: what of the balance of forces is neither inertia nor spring.

    Measured: - m a_spool - k z with the fitted k, from both accelerations without phase; the law passed the
    same filter, so that like is compared with like.

    Attributes:
        velocity, force: a sample of the measured points, m/s and N, shape (n,).
        centres: of the bins of velocity, m/s, shape (b,).
        measured, low, high: median and quartiles of the measured force in each bin, N, shape (b,).
        law: median of the model's force in each bin, N, shape (b,).
    """

    velocity: Array
    force: Array
    centres: Array
    measured: Array
    low: Array
    high: Array
    law: Array


@dataclass(frozen=True, slots=True)
class Overlay:
    """Overlay of measured and simulated spool acceleration in the windows of a free run, m/s^2."""

    run: FreeRun
    responses: tuple[Response, ...]
    observation: Observation = USUAL

    def measured(self, excerpt: Excerpt) -> Array:
        """Return the accelerometer's reading, shape (n,)."""
        return self.run.windows[excerpt.window].measured[excerpt.first : excerpt.stop]

    def simulated(self, excerpt: Excerpt) -> Array:
        """Return the free run, shape (n,)."""
        return np.asarray(self.responses[excerpt.window].acceleration[0, excerpt.first : excerpt.stop])


def overlay(records: Sequence[Record], fit: Fit, valve: Valve) -> Overlay:
    """Return the free run of a fitted model over ``records``, in windows of ``WINDOW`` s.

    Raises:
        InputError: no record is long enough.
    """
    run = FreeRun(records, fit.model, valve, window=WINDOW, low_cut=LOW_CUT, longest=LONGEST)
    run.choose_substeps(fit.values)
    reading = Reading(fit.sensor.get(SPOOL_GAIN, 0.0), fit.sensor.get(SPOOL_DELAY, 0.0), fit.observation)
    return Overlay(run, tuple(run.responses(run.sets(fit.values), [reading])), fit.observation)


def excerpts(run: FreeRun) -> list[Excerpt]:
    """Return the excerpt with the largest motion, and one at 60 Hz or else at the record's main frequency."""
    pieces = _pieces(run)
    strongest = max((float(power[1:].sum()) for *_, power in pieces), default=0.0)
    shares = [
        (float(power[np.abs(frequency - PAPER_FREQUENCY) <= 5.0].sum()) / total, number, centre)
        for number, centre, frequency, power in pieces
        if (total := float(power[1:].sum())) > 1e-3 * strongest
    ]
    share, window, centre = max(shares, default=(0.0, 0, 0))
    wanted, title = PAPER_FREQUENCY, f"at {PAPER_FREQUENCY:.0f} Hz"
    if share < ONE_FREQUENCY:  # the body never shakes at little else
        longest = max((frequency.size for *_, frequency, _ in pieces), default=0)
        alike = [(frequency, power) for *_, frequency, power in pieces if frequency.size == longest]
        wanted = _line(alike[0][0], np.sum([power for _, power in alike], axis=0)) if alike else 1.0
        title = f"main frequency, {wanted:.0f} Hz"
        powers = (
            (float(power[np.abs(frequency - wanted) <= 2.5].sum()), number, centre)
            for number, centre, frequency, power in pieces
        )
        _, window, centre = max(powers, default=(0.0, 0, 0))
    return [_largest_motion(run, pieces), _around(run, title, window, centre, wanted)]


def highest_frequency(run: FreeRun) -> float:
    """Return up to which frequency, Hz, amplitudes are worth comparing: a little beyond the excitation."""
    return 1.2 * max(100.0, *run.highest_frequency)


def friction(records: Sequence[Record], fit: Fit, valve: Valve) -> FrictionCurve:
    """Return measured and fitted friction over velocity.

    Raises:
        InputError: no record is long enough.
    """
    run = FreeRun(records, fit.model, valve, low_cut=LOW_CUT)
    stiffness, mass = fit.values["spring_stiffness"], fit.values["mass"]
    parts = []
    for number, some in first_seconds(run.records, LONGEST, shortest=5.0 / LOW_CUT):
        both = ZeroPhase(some.sample_period, LOW_CUT, 1.5 * max(run.highest_frequency[number], 30.0))
        motion = relative_motion(some.body, some.spool, ZeroPhase(some.sample_period, LOW_CUT))
        model = run.motion.forces(
            motion.displacement, motion.velocity, run.sets(fit.values),
            sample_period=some.sample_period, first_sample=some.first_sample,
        )[0]  # fmt: skip
        inside = slice(2 * both.settling, some.body.size - 2 * both.settling)
        spring = stiffness * both.apply(motion.displacement)
        rows = (motion.velocity, -mass * both.apply(motion.spool) - spring, both.apply(model) - spring)
        parts.append([row[inside] for row in rows])
    if not parts:
        raise InputError("no stretch is long enough for the motion of both accelerometers to settle")
    velocity, force, law = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    reach = float(np.quantile(np.abs(velocity), 0.998))
    # Finer where friction changes: around reversal.
    edges = reach * np.sinh(np.linspace(-3.0, 3.0, BINS + 1)) / np.sinh(3.0)
    place = np.digitize(velocity, edges) - 1
    bins = []
    for number in range(BINS):
        own = place == number
        if np.count_nonzero(own) >= LEAST:
            low, middle, high = np.quantile(force[own], (0.25, 0.5, 0.75)).tolist()
            centre = 0.5 * float(edges[number] + edges[number + 1])
            bins.append((centre, middle, low, high, float(np.median(law[own]))))
    table = np.array(bins).reshape(-1, 5)
    chosen = np.random.default_rng(0).permutation(velocity.size)[:POINTS]
    return FrictionCurve(velocity[chosen], force[chosen], *table.T)


def spectra(records: Sequence[Record]) -> tuple[Array, Array, float]:
    """Return frequency (Hz), power density of the spool's acceleration, (m/s^2)^2/Hz, and its noise floor.

    The noise floor is the lower quartile of the upper half of the spectrum, taken as medians over time: what
    passes a frequency now and then, as a sweep's harmonics do, is not noise. It is an upper bound.
    """
    period = min(entry.sample_period for entry in records)
    rows = [entry.spool for entry in records if entry.sample_period == period]
    frequency, mean = density_of(rows, period)
    _, middle = density_of(rows, period, 0.2, "median")
    return frequency, mean, float(np.quantile(middle[middle.size // 2 :], 0.25))


def sensor_noise(records: Sequence[Record]) -> float:
    """Return an upper bound of the rms noise of the spool's accelerometer, m/s^2."""
    _, _, floor = spectra(records)
    return float(np.sqrt(0.5 * floor / min(entry.sample_period for entry in records)))


#: Window, central sample, frequencies (Hz) and power of a piece of the body's acceleration.
Piece: TypeAlias = tuple[int, int, Array, Array]


def _largest_motion(run: FreeRun, pieces: Sequence[Piece]) -> Excerpt:
    best = (-1.0, 0, 0)
    for number, entry in enumerate(run.records):
        motion = relative_motion(entry.body, entry.spool, ZeroPhase(entry.sample_period, LOW_CUT))
        size = np.abs(motion.displacement)
        size[size.size - motion.settling :] = 0.0  # mirror images reach there
        for place, window in enumerate(run.windows):
            if window.record == number:
                part = size[window.start : window.stop]
                at = int(np.argmax(part))
                best = max(best, (float(part[at]), place, at))
    reach, chosen, centre = best
    own = [piece for piece in pieces if piece[0] == chosen]
    nearest = min(own, key=lambda piece: abs(piece[1] - centre), default=None)
    wanted = PAPER_FREQUENCY if nearest is None else _line(*nearest[2:])
    return _around(run, f"largest motion, {1e3 * reach:.2g} mm", chosen, centre, wanted)


def _line(frequency: Array, power: Array) -> float:
    """Return the strongest frequency, Hz."""
    return max(float(frequency[1 + int(np.argmax(power[1:]))]), 1.0)


def _around(run: FreeRun, title: str, number: int, centre: int, frequency: float) -> Excerpt:
    window = run.windows[number]
    entry = run.records[window.record]
    length = min(window.measured.size, max(16, round(PERIODS / frequency / entry.sample_period)))
    first = min(max(0, centre - length // 2), window.measured.size - length)
    origin = entry.start if entry.origin is None else entry.origin
    start = (entry.start - origin) * 1e-9 + (window.start + first) * entry.sample_period
    return Excerpt(title, number, first, first + length, start)


def _pieces(run: FreeRun) -> list[Piece]:
    pieces = []
    for number, window in enumerate(run.windows):
        entry = run.records[window.record]
        length = min(window.measured.size, max(16, round(LOOK / entry.sample_period)))
        frequency = np.fft.rfftfreq(length, entry.sample_period)
        taper = np.hanning(length + 2)[1:-1]
        body = entry.body[window.start : window.stop]
        for first in range(0, body.size - length + 1, max(1, length // 2)):
            power = np.abs(np.fft.rfft(body[first : first + length] * taper)) ** 2
            pieces.append((number, first + length // 2, np.asarray(frequency), np.asarray(power)))
    return pieces
