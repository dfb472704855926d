"""Excitation by the body: sines, sweeps, broadband, recorded motion, and presets by name."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from spool_core.errors import InputError
from spool_core.files import file_of
from spool_core.numbers import Array

from spool_sim.valve import NotNegative, Number, Positive, one_line, read_mapping

TURN = 2.0 * math.pi
#: Values of sines that are computed at once, chosen for a processor's cache: 160 kB.
_TOGETHER = 20_000

#: Samples on each side that one value between samples is made from, and the power of their window.
_REACH = 24
_ORDER = 6
#: Share of the power that may lie above what counts as the highest frequency.
_REST = 1e-4


class Excitation(BaseModel, ABC):
    """Body acceleration as a pure function of time; frozen, no state.

    Attributes:
        soft_start: s over which the amplitude rises from zero at t = 0 (raised cosine); 0 for none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    soft_start: NotNegative = 0.0

    def acceleration(self, t: Array) -> Array:
        """Return the body acceleration (m/s^2, shape of ``t``) at times ``t`` (s since the start).

        Each value depends on its own time alone, so any split of a record gives the same numbers.
        """
        t = np.asarray(t, dtype=np.float64)
        steady = self._steady(t)
        if self.soft_start > 0.0 and t.size and float(t.min()) < self.soft_start:
            steady = steady * rise(t, self.soft_start)
        return steady

    @property
    @abstractmethod
    def highest_frequency(self) -> float:
        """Highest frequency the excitation contains, Hz."""

    def speed(self, _t: float) -> float | None:
        """Return the speed (rev/min) of the machine's shaft at a time (s), ``None`` where no shaft turns."""
        return None

    @abstractmethod
    def _steady(self, t: Array) -> Array:
        """Return the acceleration without the soft start."""


class Standstill(Excitation):
    """The body does not move."""

    kind: Literal["standstill"] = "standstill"

    @property
    def highest_frequency(self) -> float:
        """0 Hz."""
        return 0.0

    def _steady(self, t: Array) -> Array:
        return np.zeros(t.shape)


class SteadySine(Excitation):
    """One frequency at a constant amplitude.

    Attributes:
        frequency: Hz.
        amplitude: peak, m/s^2.
        phase: rad at t = 0.
    """

    kind: Literal["steady_sine"] = "steady_sine"
    frequency: Positive
    amplitude: NotNegative
    phase: Number = 0.0
    soft_start: NotNegative = 0.2

    @property
    def highest_frequency(self) -> float:
        """The sine's frequency, Hz."""
        return self.frequency

    def _steady(self, t: Array) -> Array:
        return self.amplitude * turns_to_sine(self.frequency * t + self.phase / (2.0 * math.pi))


class SteppedSine(Excitation):
    """It dwells on one frequency after the other, then starts over; the phase never jumps.

    Either ``frequencies``, or ``start_frequency``, ``stop_frequency`` and ``frequency_step``.

    Attributes:
        frequencies: Hz, in the order of the steps.
        start_frequency, stop_frequency, frequency_step: Hz, the same list as a range.
        dwell: s on each frequency.
        amplitude: peak, m/s^2.
    """

    kind: Literal["stepped_sine"] = "stepped_sine"
    frequencies: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=10_000)] | None = None
    start_frequency: Positive | None = None
    stop_frequency: Positive | None = None
    frequency_step: Positive | None = None
    dwell: Positive
    amplitude: NotNegative
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _one_list(self) -> SteppedSine:
        ends = (self.start_frequency, self.stop_frequency, self.frequency_step)
        if (self.frequencies is None) == any(end is None for end in ends):
            raise ValueError(
                "give either frequencies, or all of start_frequency, stop_frequency, frequency_step"
            )
        if self.frequencies is not None and any(end is not None for end in ends):
            raise ValueError("give frequencies or a range, not both")
        if self.steps.size > 10_000:
            raise ValueError("more than 10000 steps, raise frequency_step")
        return self

    @property
    def steps(self) -> Array:
        """Frequencies of the steps, Hz, shape (steps,)."""
        if self.frequencies is not None:
            return np.array(self.frequencies)
        if self.start_frequency is None or self.stop_frequency is None or self.frequency_step is None:
            return np.empty(0)
        distance = self.stop_frequency - self.start_frequency
        count = 1 + math.floor(abs(distance) / self.frequency_step + 1e-9)
        step = math.copysign(self.frequency_step, distance)
        return np.asarray(self.start_frequency + step * np.arange(count), dtype=np.float64)

    @property
    def highest_frequency(self) -> float:
        """Highest frequency of the list, Hz."""
        return float(self.steps.max())

    def _steady(self, t: Array) -> Array:
        steps = self.steps
        turns_before = np.concatenate(([0.0], np.cumsum(steps * self.dwell)))
        cycle_time = steps.size * self.dwell
        cycle = np.floor(t / cycle_time)
        local = t - cycle * cycle_time
        index = np.minimum((local / self.dwell).astype(np.int64), steps.size - 1)
        turns = cycle * turns_before[-1] + turns_before[index] + steps[index] * (local - index * self.dwell)
        return self.amplitude * turns_to_sine(turns)


class SweptSine(Excitation):
    """Its frequency runs between two values, again and again; the phase never jumps.

    Attributes:
        start_frequency, stop_frequency: Hz.
        duration: s for one run from start to stop.
        amplitude: peak, m/s^2.
        scale: "linear" (same time per Hz) or "logarithmic" (same time per octave).
        repeat: "up_down" runs back the same way, "restart" begins again, "hold" stays at the stop frequency.
    """

    kind: Literal["swept_sine"] = "swept_sine"
    start_frequency: Positive
    stop_frequency: Positive
    duration: Positive
    amplitude: NotNegative
    scale: Literal["linear", "logarithmic"] = "linear"
    repeat: Literal["up_down", "restart", "hold"] = "up_down"
    soft_start: NotNegative = 0.2

    @property
    def highest_frequency(self) -> float:
        """The higher end of the sweep, Hz."""
        return max(self.start_frequency, self.stop_frequency)

    def _turns(self, local: Array) -> Array:
        """Return the turns made ``local`` seconds after the start of a run."""
        if self.scale == "linear" or self.start_frequency == self.stop_frequency:
            slope = (self.stop_frequency - self.start_frequency) / self.duration
            return local * (self.start_frequency + 0.5 * slope * local)
        growth = math.log(self.stop_frequency / self.start_frequency) / self.duration
        return np.asarray(self.start_frequency / growth * np.expm1(growth * local))

    def _steady(self, t: Array) -> Array:
        total = float(self._turns(np.array(self.duration)))
        if self.repeat == "hold":
            inside = np.clip(t, 0.0, self.duration)
            beyond = t - inside
            ends = np.where(beyond > 0.0, self.stop_frequency, self.start_frequency)
            return self.amplitude * turns_to_sine(self._turns(inside) + ends * beyond)
        run = np.floor(t / self.duration)
        local = t - run * self.duration
        if self.repeat == "restart":
            turns = run * total + self._turns(local)
        else:
            back = np.mod(run, 2.0) == 1.0
            turns = (run + back) * total + np.where(back, -1.0, 1.0) * self._turns(
                np.where(back, self.duration - local, local)
            )
        return self.amplitude * turns_to_sine(turns)


class Multisine(Excitation):
    """Lines of equal amplitude on whole multiples of 1 / period; repeats exactly after ``period``.

    Attributes:
        low_frequency, high_frequency: band, Hz.
        lines: how many, spread evenly over the band (fewer where the band holds fewer).
        rms: of the whole, m/s^2.
        period: s.
        seed: of the phases; the best of some draws and Schroeder's phases is kept (lowest crest factor).
    """

    kind: Literal["multisine"] = "multisine"
    low_frequency: Positive
    high_frequency: Positive
    lines: Annotated[int, Field(ge=1, le=1000)] = 60
    rms: NotNegative
    period: Positive = 10.0
    seed: Annotated[int, Field(ge=0)] = 0
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _band(self) -> Multisine:
        if self.high_frequency < self.low_frequency:
            raise ValueError("high_frequency is below low_frequency")
        if self.frequencies.size == 0:
            raise ValueError("no multiple of 1 / period lies in the band; make period longer")
        return self

    @property
    def frequencies(self) -> Array:
        """Frequencies of the lines, Hz, shape (lines,)."""
        return np.array(_multiples(self.low_frequency, self.high_frequency, self.lines, self.period))

    @property
    def highest_frequency(self) -> float:
        """Upper end of the band, Hz."""
        return self.high_frequency

    def _steady(self, t: Array) -> Array:
        frequencies = _multiples(self.low_frequency, self.high_frequency, self.lines, self.period)
        amplitudes = np.full(len(frequencies), self.rms * np.sqrt(2.0 / len(frequencies)))
        phases = _low_crest_phases(frequencies, self.period, self.seed)
        return sum_of_lines(t, np.array(frequencies), amplitudes, np.array(phases))


class MachineOrders(Excitation):
    """Harmonics of a shaft whose speed changes, on top of stationary broadband.

    Attributes:
        speed_profile: points (time s, shaft speed rpm), linear in between, held before and after.
        orders: points (order, peak amplitude m/s^2); order 2 turns twice per revolution.
        broadband_rms: m/s^2.
        broadband_low, broadband_high: band, Hz.
        broadband_lines: sines with drawn frequencies and phases that make the broadband.
        seed: of the broadband and of the orders' phases.
    """

    kind: Literal["machine_orders"] = "machine_orders"
    speed_profile: Annotated[tuple[tuple[Number, NotNegative], ...], Field(min_length=1, max_length=10_000)]
    orders: Annotated[tuple[tuple[Positive, NotNegative], ...], Field(max_length=200)]
    broadband_rms: NotNegative = 0.0
    broadband_low: Positive = 8.0
    broadband_high: Positive = 120.0
    broadband_lines: Annotated[int, Field(ge=1, le=1000)] = 120
    seed: Annotated[int, Field(ge=0)] = 0
    soft_start: NotNegative = 0.2

    @model_validator(mode="after")
    def _in_order(self) -> MachineOrders:
        times = [time for time, _ in self.speed_profile]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("times of speed_profile must rise from point to point")
        if self.broadband_high < self.broadband_low:
            raise ValueError("broadband_high is below broadband_low")
        return self

    @property
    def highest_frequency(self) -> float:
        """Highest order at the highest speed, or the upper end of the broadband, Hz."""
        fastest = max(speed for _, speed in self.speed_profile) / 60.0
        orders = max((order for order, amplitude in self.orders if amplitude > 0.0), default=0.0) * fastest
        return max(orders, self.broadband_high if self.broadband_rms > 0.0 else 0.0)

    def speed(self, t: float) -> float:
        """Return the shaft's speed at a time; see the base class."""
        return float(np.interp(t, *np.transpose(self.speed_profile)))

    def revolutions(self, t: Array) -> Array:
        """Return the shaft's revolutions since t = 0: the exact integral of the speed."""
        return self._integral(t) - self._integral(np.zeros(1))

    def _integral(self, t: Array) -> Array:
        times = np.array([time for time, _ in self.speed_profile])
        speeds = np.array([speed for _, speed in self.speed_profile]) / 60.0
        whole = np.concatenate(([0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))))
        slopes = np.concatenate((np.diff(speeds) / np.diff(times), [0.0]))
        index = np.clip(np.searchsorted(times, t, side="right") - 1, 0, times.size - 1)
        local = t - times[index]
        before = local < 0.0
        return np.asarray(
            whole[index] + local * (speeds[index] + 0.5 * np.where(before, 0.0, slopes[index]) * local)
        )

    def _steady(self, t: Array) -> Array:
        generator = np.random.default_rng(self.seed)
        order_phases = generator.random(len(self.orders))
        revolutions = self.revolutions(t)
        total = np.zeros(t.shape)
        for (order, amplitude), phase in zip(self.orders, order_phases, strict=True):
            total += amplitude * turns_to_sine(order * revolutions + phase)
        if self.broadband_rms > 0.0:
            # One line per stretch of the band, placed at random in it: no common period for hours.
            count = self.broadband_lines
            places = (np.arange(count) + generator.random(count)) / count
            band = self.broadband_high - self.broadband_low
            frequencies = np.asarray(self.broadband_low + band * places, dtype=np.float64)
            amplitudes = np.full(count, self.broadband_rms * np.sqrt(2.0 / count))
            total += sum_of_lines(t, frequencies, amplitudes, generator.random(count))
        return total


def rise(t: Array, duration: float) -> Array:
    """Return the raised cosine from 0 (t <= 0) to 1 (t >= duration)."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(t / duration, 0.0, 1.0)))


def turns_to_sine(turns: Array) -> Array:
    """Return sin(2 pi turns); whole turns are taken off first, which keeps late times exact."""
    part = np.subtract(turns, np.floor(turns))
    part *= TURN
    return np.asarray(np.sin(part))


def sum_of_lines(t: Array, frequencies: Array, amplitudes: Array, phases: Array) -> Array:
    """Return the sum of sines: Hz, m/s^2 peak and turns, each of shape (lines,).

    One line after the other: the order of the sum does not depend on how many times are asked for.
    """
    total = np.zeros(t.shape)
    several = max(1, _TOGETHER // max(1, t.size))
    for first in range(0, frequencies.size, several):
        part = slice(first, first + several), np.newaxis
        turns = frequencies[part] * t + phases[part]
        for sine in amplitudes[part] * turns_to_sine(turns):
            total += sine
    return total


@lru_cache(maxsize=64)
def _multiples(low: float, high: float, lines: int, period: float) -> tuple[float, ...]:
    """Return at most ``lines`` multiples of 1 / ``period`` (s), spread over the band from low to high, Hz."""
    first = max(int(np.ceil(low * period - 1e-9)), 1)
    last = int(np.floor(high * period + 1e-9))
    if last < first:
        return ()
    return tuple((np.unique(np.rint(np.linspace(first, last, lines))) / period).tolist())


@lru_cache(maxsize=64)
def _low_crest_phases(frequencies: tuple[float, ...], period: float, seed: int) -> tuple[float, ...]:
    """Return phases (turns) of a low crest factor: from Schroeder's and drawn ones, by clipping peaks."""
    count = len(frequencies)
    number = np.rint(np.array(frequencies) * period).astype(np.int64)
    samples = int(2 ** np.ceil(np.log2(8 * number[-1])))
    generator = np.random.default_rng(seed)
    line = np.arange(count)
    best_peak = np.inf
    best: Array = np.zeros(count)
    for start in (generator.random() - line * (line + 1) / (2.0 * count), generator.random(count)):
        phases: Array = np.asarray(start, dtype=np.float64)
        for _ in range(40):
            spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
            spectrum[number] = np.exp(2j * np.pi * (phases - 0.25))
            signal = np.fft.irfft(spectrum)
            peak = float(np.abs(signal).max())
            if peak < best_peak:
                best_peak, best = peak, phases
            clipped = np.fft.rfft(np.clip(signal, -0.8 * peak, 0.8 * peak))
            turns = np.angle(clipped[number]) / (2.0 * np.pi)
            phases = np.asarray(turns + 0.25, dtype=np.float64)
    return tuple(np.mod(best, 1.0).tolist())


SingleExcitation = Annotated[
    Standstill | SteadySine | SteppedSine | SweptSine | Multisine | MachineOrders, Field(discriminator="kind")
]


class Sequence(Excitation):
    """Excitations one after the other, cross-faded so that nothing jumps.

    Attributes:
        parts: the stretches; the last one goes on when all are over, unless ``repeat``.
        fade: s around each border in which one fades out and the next fades in.
        repeat: start over after the last part.
    """

    kind: Literal["sequence"] = "sequence"
    parts: Annotated[tuple[Part, ...], Field(min_length=1, max_length=1000)]
    fade: NotNegative = 0.2
    repeat: bool = False

    @model_validator(mode="after")
    def _fade_fits(self) -> Sequence:
        shortest = min(part.duration for part in self.parts)
        if self.fade > shortest:
            raise ValueError(f"fade is longer than the shortest part ({shortest:g} s)")
        if self.repeat and len(self.parts) < 2:
            raise ValueError("repeat needs two parts or more")
        return self

    @property
    def duration(self) -> float:
        """Length of all parts, s."""
        return sum(part.duration for part in self.parts)

    @property
    def highest_frequency(self) -> float:
        """Highest of the parts, Hz."""
        return max(part.excitation.highest_frequency for part in self.parts)

    def _steady(self, t: Array) -> Array:
        total = np.zeros(t.shape)
        start = 0.0
        for number, part in enumerate(self.parts):
            first, last = number == 0, number == len(self.parts) - 1
            local, run = t - start, np.zeros(t.shape)
            if self.repeat:
                run = np.floor((local + 0.5 * (self.duration - part.duration)) / self.duration)
                local = local - run * self.duration
            weight = np.ones(t.shape) if first else self._ramp(local)
            if first and self.repeat:
                weight = np.where(run == 0.0, 1.0, self._ramp(local))
            if self.repeat or not last:
                weight = weight * (1.0 - self._ramp(local - part.duration))
            # Nothing has been before the first run.
            active = (weight > 0.0) & (run >= 0.0)
            if active.any():
                total[active] += weight[active] * part.excitation.acceleration(local[active])
            start += part.duration
        return total

    def _ramp(self, t: Array) -> Array:
        """Return the weight of what begins at t = 0: from 0 to 1 within fade / 2 on both sides."""
        if self.fade == 0.0:
            return np.asarray(t >= 0.0, dtype=np.float64)
        return rise(t + 0.5 * self.fade, self.fade)


class Part(BaseModel):
    """One excitation and how long it lasts in a sequence.

    Attributes:
        duration: s.
        excitation: what acts; its own time starts with the stretch.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    duration: Positive
    excitation: SingleExcitation


AnyExcitation = Annotated[SingleExcitation | Sequence, Field(discriminator="kind")]
_ADAPTER: TypeAdapter[Excitation] = TypeAdapter(AnyExcitation)
KINDS: tuple[str, ...] = (
    "standstill", "steady_sine", "stepped_sine", "swept_sine", "multisine", "machine_orders", "sequence",
)  # fmt: skip

PRESETS: dict[str, Excitation] = {
    "standstill": Standstill(),
    "steady": SteadySine(frequency=30.0, amplitude=10.0),
    # The paper's series ran from 10 to 100 Hz.
    "stepped": SteppedSine(
        start_frequency=10.0, stop_frequency=100.0, frequency_step=5.0, dwell=2.0, amplitude=10.0
    ),
    "sweep": SweptSine(start_frequency=10.0, stop_frequency=100.0, duration=20.0, amplitude=10.0),
    "multisine": Multisine(low_frequency=10.0, high_frequency=100.0, rms=7.0),
    "orders": MachineOrders(
        speed_profile=((0.0, 600.0), (20.0, 2400.0), (40.0, 2400.0), (60.0, 600.0)),
        orders=((1.0, 6.0), (2.0, 3.0)),
        broadband_rms=4.0,
    ),
    # Order 1 passes 15 Hz, then order 2 passes 29 Hz.
    "run_up": MachineOrders(
        speed_profile=((0.0, 600.0), (10.0, 600.0), (75.0, 1250.0)),
        orders=((1.0, 4.0), (2.0, 6.0)),
        broadband_rms=1.0,
    ),
}


class Recorded(Excitation):
    """Body acceleration of a record; the body stands still before and after it.

    Between samples it is band-limited: sinc under a window over 48 samples, within 2e-4 of the truth up to
    0.4 of the sample rate; at the samples it is the samples. Beyond the ends the record goes on as its mirror
    image through the end point, for the interpolation only.

    Attributes:
        samples: m/s^2, shape (n,), evenly spaced.
        sample_rate: Hz.
        source: where the record comes from, for messages.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    kind: Literal["recorded"] = "recorded"
    samples: Annotated[Array, BeforeValidator(_samples), Field(repr=False)]
    sample_rate: Annotated[Number, Field(ge=1.0, le=1e6)]
    source: str = "record"

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return (self.samples.size - 1) / self.sample_rate

    @cached_property
    def highest_frequency(self) -> float:
        """Frequency, Hz, below which all but 1e-4 of the power lies; less than half the sample rate."""
        window = np.hanning(self.samples.size + 2)[1:-1]
        power = np.abs(np.fft.rfft(self.samples * window)) ** 2
        if not power.any():
            return 0.0
        share = np.cumsum(power) / power.sum()
        line = int(np.searchsorted(share, 1.0 - _REST))
        highest = 0.5 * self.sample_rate * (1.0 - 1e-6)
        return min(highest, (line + 1) * self.sample_rate / self.samples.size)

    @cached_property
    def _continued(self) -> Array:
        """The record with its mirror images, turned about the end points, shape (n + 2 reach,)."""
        return np.pad(self.samples, _REACH, mode="reflect", reflect_type="odd")

    def _steady(self, t: Array) -> Array:
        inside = (t >= 0.0) & (t <= self.duration)
        place = t[inside] * self.sample_rate
        before = np.minimum(np.floor(place).astype(np.int64), self.samples.size - 1)
        beyond = place - before
        # sin(pi (x - n)) of all nodes is that of one node but for its sign.
        sine = np.sin(np.pi * beyond) / np.pi
        values = np.zeros(place.size)
        for node in range(1 - _REACH, _REACH + 1):
            distance = beyond - node
            at_node = np.abs(distance) < 1e-9
            sinc = np.where(at_node, 1.0, (1 - 2 * (node % 2)) * sine / np.where(at_node, 1.0, distance))
            window = np.maximum(0.0, 1.0 - (distance / _REACH) ** 2)
            values += sinc * window**_ORDER * self._continued[before + (node + _REACH)]
        total = np.zeros(t.shape)
        total[inside] = values
        return total


def from_mapping(mapping: Mapping[str, Any], where: str = "excitation") -> Excitation:
    """Return the excitation that ``mapping`` describes: its ``kind`` and that kind's fields.

    Raises:
        InputError: unknown kind or key, missing key, value out of range; ``where`` and the key are named.
    """
    kind = mapping.get("kind")
    if kind == "recorded":
        raise InputError(f"{where}: kind: 'recorded' works only in ./spool simulate --excitation")
    if kind not in KINDS:
        given = "key is missing" if kind is None else f"unknown kind {kind!r}"
        raise InputError(f"{where}: kind: {given}; use one of {', '.join(KINDS)}")
    try:
        return _ADAPTER.validate_python(dict(mapping))
    except ValidationError as error:
        raise one_line(error, where) from None


def load_excitation(name_or_path: str | Path) -> Excitation:
    """Return a preset by its name, or the excitation that a YAML file describes.

    Raises:
        InputError: neither a preset nor a readable file with a valid excitation.
    """
    preset = PRESETS.get(str(name_or_path))
    if preset is not None:
        return preset
    path = file_of(name_or_path, "excitation", PRESETS)
    return from_mapping(read_mapping(path, "excitation"), str(path))


def _samples(given: object) -> Array:
    values = np.array(given, dtype=np.float64)
    if values.ndim != 1 or values.size < 2:
        raise ValueError("a record needs one row of at least two samples")
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise ValueError(f"sample {bad[0]} is not a number ({bad.size} such in all)")
    values.setflags(write=False)
    return values
