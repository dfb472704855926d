"""Free run: the spool's motion simulated from the measured body acceleration alone.

A record is cut into windows that overlap by their run-in. Each starts from the motion that the accelerometers
show, runs free from there, and counts once the start is forgotten. Between samples the excitation is
band-limited (Fourier interpolation with real samples beyond both ends), and the noise above it is taken off
without phase, so that it does not shake dry friction loose.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from spool_core.errors import InputError
from spool_core.numbers import Array
from spool_core.system import processors
from spool_sim.integration.composed_motion import ComposedMotion, MotionState, substeps_to_compare
from spool_sim.model import Model
from spool_sim.observation import LINEAR, REACH, Observation, Spectrum, lines_of
from spool_sim.valve import Valve

from spool_estimator.identification.chain import LOWEST, ChainPart
from spool_estimator.identification.least_squares import Work, in_parallel
from spool_estimator.identification.record import Record
from spool_estimator.identification.spectra import ZeroPhase, faded, relative_motion

#: s of samples on both sides of a window that its interpolation uses.
MARGIN = 0.25
#: How far the spectrum must stand out of the noise floor to count as excitation, in power.
STANDS_OUT = 4.0
#: Samples that are simulated sooner by one thread than threads are begun.
SINGLE = 20_000
#: Steps per sample at most, whatever a fit tries.
MOST_STEPS = 16
#: Samples that are simulated after the last one that counts: a low-pass without phase rings before a jump.
AFTER = REACH
#: Smallest factor of a channel's response that is undone, and observations whose excitations are kept.
SMALLEST, DRIVES = 0.1, 4
#: m/s^2 from which a change of the acceleration is a jump.
LEAST_JUMP = 1e-6
#: Quantile of the spool's acceleration relative to the body that it has at reversals of a strong motion.
REVERSING = 0.95
#: How a good chain reads: sharp, without phase, below half the rate.
USUAL = Observation(LINEAR, 6, 0.42)
#: Gain of the excitation falls from 1 to 0 from its highest frequency to this many times it.
FALL = 1.3


@dataclass(frozen=True, slots=True)
class Window:
    """One stretch that is simulated in one piece.

    Attributes:
        record: its number.
        first: sample at which the simulation starts.
        start, stop: samples that count, ``stop`` exclusive.
        excitation: spectrum of the body acceleration around it.
        margin: samples of the excitation before ``first``.
        length: samples of the excitation.
        state: relative displacement (m) and velocity (m/s) at ``first``, from the accelerometers.
        measured: spool acceleration from ``start`` to ``stop``, m/s^2.
        viscosity: its ratio to that of the valve's description from ``first`` to ``stop`` and ``AFTER``.
    """

    record: int
    first: int
    start: int
    stop: int
    excitation: NDArray[np.complex128]
    margin: int
    length: int
    state: tuple[float, float]
    measured: Array
    viscosity: Array | None


@dataclass(frozen=True, slots=True)
class Response:
    """Motion in one window for s parameter sets; every array has shape (s, n), n the samples that count.

    Attributes:
        acceleration: of the spool as its channel reads it, m/s^2, gain error included.
        displacement, velocity: relative to the body, m, m/s.
        jumps: instants at which the acceleration of the first set jumps, samples from ``start``, shape (j,).
    """

    acceleration: Array
    displacement: Array
    velocity: Array
    jumps: Array


@dataclass(frozen=True, slots=True)
class Reading:
    """What the measuring chain makes of the motion.

    Attributes:
        gain, delay: relative gain error and delay (s) of the spool's channel behind the body's.
        observation: of both channels.
        parts: further parts of the chain, with their numbers.
    """

    gain: float = 0.0
    delay: float = 0.0
    observation: Observation = USUAL
    parts: tuple[tuple[ChainPart, tuple[float, ...]], ...] = ()

    def of(self, channel: str) -> tuple[tuple[ChainPart, tuple[float, ...]], ...]:
        """Return the parts that are filters of ``channel``."""
        return tuple(one for one in self.parts if one[0].channel == channel and one[0].response is not None)


def response_of(parts: Iterable[tuple[ChainPart, tuple[float, ...]]], frequency: Array) -> Spectrum:
    """Return the factor of ``parts`` on a spectrum at ``frequency``, Hz."""
    found: Spectrum = np.ones(frequency.size, dtype=np.complex128)
    for part, numbers in parts:
        if part.response is not None:
            found *= part.response(np.maximum(frequency, LOWEST), numbers)
    return found


class FreeRun:
    """The windows of some records, and the response of a model over them.

    Attributes:
        model, valve: as given.
        motion: the compiled composition.
        names: of the model's parameters, the columns of parameter sets.
        windows: what is simulated.
        highest_frequency: of the excitation, Hz, for each record.
        substeps: steps per sample, for each record.
        work: that all runs made from this one share.
    """

    def __init__(
        self,
        records: Sequence[Record],
        model: Model,
        valve: Valve,
        *,
        window: float = float("inf"),
        run_in: float = 0.5,
        low_cut: float = 3.0,
        longest: float = float("inf"),
        work: Work | None = None,
    ) -> None:
        """Cut the records and prepare their excitations.

        Args:
            records: without gaps each.
            model: any composition of force terms.
            valve: gives the start values for the step size, and the oil.
            window: s that are simulated in one piece, run-in not counted; infinite for whole records.
            run_in: s at the start of each window that do not count.
            low_cut: Hz, of the conditioning that gives the motion to start from.
            longest: s of data used at most, in windows spread evenly.
            work: counts the simulated steps; without a limit by default.

        Raises:
            InputError: no record is long enough for one window.
        """
        self.records = tuple(records)
        self.model = model
        self.valve = valve
        self.work = work or Work(float("inf"))
        self.motion: ComposedMotion = ComposedMotion(model.terms)
        self.names = self.motion.names
        self.highest_frequency = [excitation_limit(entry) for entry in self.records]
        self.accelerations = [
            float(np.nanquantile(np.abs(entry.spool - entry.body), REVERSING)) for entry in self.records
        ]
        self.substeps = [1] * len(self.records)
        self._drives: dict[tuple[object, ...], Array] = {}
        windows: list[Window] = []
        for number, entry in enumerate(self.records):
            windows += self._cut(number, entry, window, run_in, low_cut)
        if not windows:
            longest_one = max((entry.duration for entry in self.records), default=0.0)
            needed = run_in + 2.0 / low_cut
            raise InputError(
                f"{self.records[0].name if self.records else 'records'}: the longest stretch without gaps "
                f"has {longest_one:.2f} s, a fit needs more than {needed:.2f} s"
            )
        self.windows = _spread(windows, longest, [entry.sample_period for entry in self.records])
        self.choose_substeps(model.values_for(valve))

    def _cut(self, number: int, entry: Record, window: float, run_in: float, low_cut: float) -> list[Window]:
        period = entry.sample_period
        conditioning = ZeroPhase(period, low_cut)
        # At its ends the conditioned motion is not known; the free run may go on to the last sample.
        begin = conditioning.settling
        lead = max(1, round(run_in / period))
        last = entry.body.size - 2 - AFTER  # what a low-pass rings before a jump
        room = last - begin - lead
        if room < max(16, lead):
            return []
        motion = relative_motion(entry.body, entry.spool, conditioning)
        count = max(1, round(room * period / window)) if np.isfinite(window) else 1
        edges = begin + lead + (room * np.arange(count + 1)) // count
        margin = round(MARGIN / period)
        viscosity = self._viscosity(entry)
        cut = []
        for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            first = start - lead
            low = first - margin
            high = low + fft.next_fast_len(stop + 2 + AFTER + margin - low, real=True)
            excitation = limited(
                _around(entry.body, low, high, max(1, margin // 2)), period, self.highest_frequency[number]
            )
            cut.append(
                Window(
                    number,
                    first,
                    start,
                    stop,
                    fft.rfft(excitation),
                    margin,
                    excitation.size,
                    (float(motion.displacement[first]), float(motion.velocity[first])),
                    entry.spool[start:stop],
                    None if viscosity is None else viscosity[first : stop + AFTER],
                )
            )
        return cut

    def _viscosity(self, entry: Record) -> Array | None:
        """Return the ratio of viscosities at each sample, where record and valve give it."""
        if entry.oil_temperature is None or not self.valve.oil_ratio_known:
            return None
        if not np.isfinite(entry.oil_temperature).all():
            return None
        low, high = float(entry.oil_temperature.min()), float(entry.oil_temperature.max())
        points = np.linspace(low, high, 1 + int(high > low) * 64)
        ratios = [
            self.valve.dynamic_viscosity_at(point) / self.valve.dynamic_viscosity for point in points.tolist()
        ]
        return np.interp(entry.oil_temperature, points, ratios)

    def fewer(self, seconds: float) -> FreeRun:
        """Return the same with windows for at most ``seconds``, evenly spread."""
        some = copy.copy(self)
        some.windows = _spread(list(self.windows), seconds, [entry.sample_period for entry in self.records])
        return some

    def of(self, model: Model, motion: ComposedMotion | None = None) -> FreeRun:
        """Return the same windows under another ``model``, stepped by ``motion`` where it is given."""
        other = copy.copy(self)
        other.model = model
        other.motion = ComposedMotion(model.terms) if motion is None else motion
        other.names = other.motion.names
        other.substeps = list(self.substeps)
        return other

    def driven_by(self, windows: Sequence[Window]) -> FreeRun:
        """Return the same with other ``windows`` of the same records."""
        other = copy.copy(self)
        other.windows, other._drives = tuple(windows), {}
        return other

    def choose_substeps(self, values: Mapping[str, float]) -> bool:
        """Take as many steps per sample as the model needs with ``values``; return whether that changed."""
        before = list(self.substeps)
        entries = zip(self.records, self.highest_frequency, self.accelerations, strict=True)
        self.substeps = [
            min(MOST_STEPS, substeps_to_compare(self.model.terms, values, entry.sample_period, *rates))
            for entry, *rates in entries
        ]
        return before != self.substeps

    @property
    def steps(self) -> float:
        """Simulated steps of one set of parameters in all windows."""
        return float(sum((one.stop - one.first) * self.substeps[one.record] for one in self.windows))

    def sets(self, values: Mapping[str, float]) -> Array:
        """Return one set of parameters as ``responses`` takes it, shape (1, p)."""
        return np.array([[float(values[name]) for name in self.names]])

    def responses(self, sets: Array, readings: Sequence[Reading] | None = None) -> list[Response]:
        """Return the response in each window.

        Args:
            sets: parameters, shape (s, p), in the order of ``names``.
            readings: of the spool's channel for each set; without, the usual ones of a good chain.
        """
        count = sets.shape[0]
        self.work.add(count * self.steps)
        read = [Reading()] * count if readings is None else list(readings)
        if count * sum(window.stop - window.first for window in self.windows) < SINGLE:
            return [self._respond(window, sets, read) for window in self.windows]
        # Windows or, where there are few of them, groups of the sets at once.
        pieces = min(count, -(-processors() // len(self.windows)))
        cuts = np.linspace(0, count, pieces + 1).astype(int).tolist()
        jobs = [(window, slice(*cut)) for window in self.windows for cut in pairwise(cuts)]
        found = in_parallel(lambda job: self._respond(job[0], sets[job[1]], read[job[1]]), jobs)
        return [_joined(found[place : place + pieces]) for place in range(0, len(found), pieces)]

    def _respond(self, window: Window, sets: Array, readings: Sequence[Reading]) -> Response:
        entry = self.records[window.record]
        substeps = self.substeps[window.record]
        state = MotionState(*window.state, float(np.sign(window.state[1])))
        causes = [(one.observation.of_body(), one.of("body")) for one in readings]
        distinct = list(dict.fromkeys(causes))
        tables = sets[:, np.newaxis, :]
        if window.viscosity is not None and "viscous_coefficient" in self.names:
            tables = np.repeat(tables, window.viscosity.size, axis=1)
            tables[:, :, self.names.index("viscous_coefficient")] *= window.viscosity
        # Gain, delay and parts of the spool's channel leave the motion as it is.
        whole = [(distinct.index(one), row.tobytes()) for one, row in zip(causes, sets, strict=True)]
        motions = list(dict.fromkeys(whole))
        found = self.motion.read_batch(
            state,
            np.array([self._drive(window, substeps, *one) for one in distinct]),
            tables[[whole.index(one) for one in motions]],
            rows=np.array([row for row, _ in motions]),
            sample_period=entry.sample_period,
            substeps=substeps,
            first_sample=entry.first_sample + window.first,
        )
        runs = [found[motions.index(one)] for one in whole]
        lead, count = window.start - window.first, window.stop - window.start
        part = slice(lead, lead + count)
        period = entry.sample_period
        time: Array = period * (entry.first_sample + window.start + np.arange(count, dtype=np.float64))
        rows = []
        for run, one in zip(runs, readings, strict=True):
            gains = None
            if one.of("spool"):
                lines = lines_of(run.acceleration.size // substeps, substeps)
                gains = response_of(one.of("spool"), lines / period)
            row = one.observation.read(run.acceleration, run.events, substeps, one.delay / period, gains)
            row = row[part] * (1.0 + one.gain)
            for chained, numbers in one.parts:
                if chained.factor is not None:
                    row *= chained.factor(row, time, numbers)
            rows.append(row)
        return Response(
            np.array(rows),
            np.array([run.displacement[part] for run in runs]),
            np.array([run.velocity[part] for run in runs]),
            runs[0].events[np.abs(runs[0].events[:, 1]) > LEAST_JUMP, 0] / substeps - lead,
        )

    def _drive(
        self,
        window: Window,
        substeps: int,
        observation: Observation,
        parts: tuple[tuple[ChainPart, tuple[float, ...]], ...],
    ) -> Array:
        """Return the acceleration of the body at the half steps of ``window``, m/s^2: the reading's cause."""
        key = (id(window.excitation), substeps, observation, parts)
        kept = self._drives.get(key)
        if kept is not None:
            return kept
        frequency = fft.rfftfreq(window.length)
        period = self.records[window.record].sample_period
        response = observation.response(frequency) * response_of(parts, frequency / period)
        size = np.maximum(np.abs(response), SMALLEST)
        # The excitation has nothing left at half the sample rate, so its line there needs no halving.
        finer = 2 * substeps
        fine = fft.irfft(window.excitation * np.conj(response) / size**2, finer * window.length)
        first = finer * window.margin
        found = np.asarray(fine[first : first + finer * (window.stop + AFTER - window.first) + 1] * finer)
        if len(self._drives) > DRIVES * len(self.windows):
            self._drives.clear()
        self._drives[key] = found
        return found


def _joined(rows: Sequence[Response]) -> Response:
    """Return responses of several groups of sets as one; jumps are those of the first set."""
    if len(rows) == 1:
        return rows[0]
    return Response(
        np.concatenate([one.acceleration for one in rows]),
        np.concatenate([one.displacement for one in rows]),
        np.concatenate([one.velocity for one in rows]),
        rows[0].jumps,
    )


def excitation_limit(entry: Record) -> float:
    """Return the highest frequency, Hz, at which the body's acceleration stands out of its noise floor.

    The noise floor is the lower quartile of the smoothed spectrum's upper half; without one it is half the
    sample rate.
    """
    n = entry.body.size
    segment = min(n, max(64, round(1.0 / entry.sample_period)))
    count = max(1, n // segment)
    pieces = entry.body[: count * segment].reshape(count, segment)
    window = np.hanning(segment + 2)[1:-1]
    power = np.abs(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window)) ** 2
    spectrum = np.sort(power, axis=0)[count // 2 :].mean(axis=0) if count > 2 else power.mean(axis=0)
    width = max(1, spectrum.size // 100)
    smooth = np.convolve(spectrum, np.full(width, 1.0 / width), mode="same")
    frequency = np.fft.rfftfreq(segment, entry.sample_period)
    floor = float(np.quantile(smooth[smooth.size // 2 :], 0.25))
    # A sweep is at each frequency for a short time only: its largest piece counts, above the same floor.
    largest = np.convolve(power.max(axis=0), np.full(width, 1.0 / width), mode="same")
    above = np.flatnonzero((smooth > STANDS_OUT * floor) | (largest > 8.0 * STANDS_OUT * floor))
    nyquist = 0.5 * entry.sample_rate
    return min(nyquist, float(frequency[min(above[-1] + width, smooth.size - 1)])) if above.size else nyquist


def limited(samples: Array, period: float, highest: float) -> Array:
    """Return ``samples`` without what lies above ``FALL`` times ``highest`` Hz."""
    if FALL * highest >= 0.5 / period:
        return samples
    gain = excitation_gain(fft.rfftfreq(samples.size, period), highest)
    return np.asarray(fft.irfft(fft.rfft(samples) * gain, samples.size))


def excitation_gain(frequency: Array, highest: float) -> Array:
    """Return the gain at ``frequency`` (Hz): 1 up to ``highest``, 0 from ``FALL`` times that on."""
    share = np.clip((frequency / highest - 1.0) / (FALL - 1.0), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * share))


def _around(samples: Array, low: int, high: int, fade: int) -> Array:
    """Return samples ``low`` to ``high``, faded to zero within ``fade`` samples of both ends.

    Beyond the record its mirror image through the end point.
    """
    before, after = max(0, -low), max(0, high - samples.size)
    inside = samples[max(0, low) : min(high, samples.size)]
    around = np.pad(inside, (before, after), mode="reflect", reflect_type="odd")
    return np.asarray(around * faded(around.size, fade))


def _spread(windows: list[Window], longest: float, periods: Sequence[float]) -> tuple[Window, ...]:
    """Return as many windows as ``longest`` s hold, evenly spread; at least one."""
    total = sum((window.stop - window.start) * periods[window.record] for window in windows)
    if total <= longest:
        return tuple(windows)
    count = max(1, int(len(windows) * longest / total))
    return tuple(windows[(2 * place + 1) * len(windows) // (2 * count)] for place in range(count))
