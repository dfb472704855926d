"""Experiment condition of a record: valve, oil, excitation, sampling, noise, nuisances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve

from spool_blind.simulator import AFTER, Plant, SpoolMotion, move, respond, steps

Array = NDArray[np.float64]

#: N/m, the paper's springs; N s/m, kg and m/s^2, drawn around its oils, spool and shaker.
SOFT, STIFF = 1632.0, 5846.0
VISCOUS = (1.2, 8.5)
MASS = (0.15, 0.22)
AMPLITUDE = (3.0, 20.0)
RATES = (1000.0, 1250.0, 2000.0, 2500.0, 4000.0, 5000.0, 8000.0, 10_000.0)
DURATION = (20.0, 60.0)
#: Rms of white noise over that of the channel's acceleration.
NOISE = (0.002, 0.02)
#: Declared tolerances of the sensors; a share of the records uses most of them.
GAIN_TOLERANCE, DELAY_TOLERANCE = 0.05, 0.5e-3
NUISANCE_SHARE = 0.4
NUISANCE_USE = 0.9
#: Hz at which the motion without effects is looked at.
SCALE_RATE = 2000.0
#: m, travel beyond which an excitation is turned down: the valve's stroke.
LARGEST_TRAVEL = 5e-3

IDLE, HAMMER, OPERATION = "engine_idle", "hammer_bursts", "operation_with_pauses"
#: Of a shaker, at levels that are drawn, and of a machine.
SHAKEN = ("sweep", "stepped_sine", "multisine", "machine_orders")
KINDS = (*SHAKEN, IDLE, HAMMER, OPERATION)
#: Hz at which an excitation is worked out; a cubic spline through it errs by 1e-6 at 150 Hz.
GRID_RATE = 8000.0
#: s over which an excitation rises from rest.
RISE = 0.5
#: s between two levels.
FADE = 0.4


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of the motion while nothing is hidden; sizes of effects are drawn in these terms.

    Attributes:
        force: rms of mass times the body's acceleration, N.
        travel, travel_peak: rms and peak of the displacement, m.
        velocity: rms, m/s.
        acceleration, acceleration_peak: rms and peak of the spool's acceleration, m/s^2.
    """

    force: float
    travel: float
    travel_peak: float
    velocity: float
    acceleration: float
    acceleration_peak: float


@dataclass(frozen=True, slots=True)
class ExperimentCondition:
    """Experiment condition, drawn.

    Attributes:
        base: the spool with nothing hidden.
        nominal_stiffness: what the valve's description says, N/m.
        excitation: of the body, to be multiplied with ``amplitude``.
        amplitude: m/s^2.
        sample_rate: Hz.
        duration: s.
        before: s of motion ahead of the record; 0: it starts at rest.
        noise_share: rms of the noise over that of the spool's acceleration.
        gain, delay: nuisances of the spool's channel, within the declared tolerances.
    """

    base: Plant
    nominal_stiffness: float
    excitation: DrawnExcitation
    amplitude: float
    sample_rate: float
    duration: float
    before: float
    noise_share: float
    gain: float
    delay: float

    def move(self, plant: Plant, like: Plant | None = None, points: int = 1) -> SpoolMotion:
        """Move ``plant`` under this excitation, in steps that suit ``like``, ``points`` a sample or more."""
        longest = min((like or plant).longest_step, 1.0 / (points * self.sample_rate))
        time, h = steps(self.duration, self.sample_rate, self.before, longest)
        return move(plant, time, h, self.amplitude * self.excitation.at(time))

    def scale(self) -> Scale:
        """Return how the base moves."""
        t: Array = np.arange(-self.before, self.duration, 1.0 / SCALE_RATE, dtype=np.float64)
        body = self.amplitude * self.excitation.at(t)
        numbers = self.base.numbers
        spool = respond(numbers, body, SCALE_RATE)
        z = respond(numbers, body, SCALE_RATE, travel=True)
        part = t > 0.0
        return Scale(
            force=float(numbers["mass"] * body[part].std()),
            travel=float(z[part].std()),
            travel_peak=float(np.abs(z[part]).max()),
            velocity=float((np.diff(z) * SCALE_RATE).std()),
            acceleration=float(spool[part].std()),
            acceleration_peak=float(np.abs(spool[part]).max()),
        )


def draw_condition(generator: np.random.Generator, *, from_rest: bool = False) -> ExperimentCondition:
    """Draw a condition whose travel stays within the stroke.

    Args:
        generator: of the numbers.
        from_rest: the record begins before the motion does.
    """
    nominal = float(generator.choice([SOFT, STIFF]))
    numbers = {
        "mass": float(generator.uniform(*MASS)),
        "stiffness": nominal * float(generator.uniform(0.96, 1.04)),
        "damping": float(np.exp(generator.uniform(*np.log(VISCOUS)))),
    }
    resonance = float(np.sqrt(numbers["stiffness"] / numbers["mass"]) / (2.0 * np.pi))
    duration = float(round(generator.uniform(*DURATION)))
    # What is drawn in which order makes the records of all seeds.
    before = float(generator.choice([0.0, 1.0]))
    before = 0.0 if from_rest else before
    kind = str(generator.choice(list(KINDS)))
    use = NUISANCE_USE if generator.random() < NUISANCE_SHARE else 0.0
    excitation = draw_excitation(generator, kind, resonance, -before, duration + AFTER)
    amplitude = float(np.exp(generator.uniform(*np.log(AMPLITUDE))))
    rate = float(generator.choice(list(RATES)))
    condition = ExperimentCondition(
        base=Plant(numbers),
        nominal_stiffness=nominal,
        excitation=excitation,
        amplitude=amplitude,
        sample_rate=rate,
        duration=duration,
        before=before,
        noise_share=float(np.exp(generator.uniform(*np.log(NOISE)))),
        gain=1.0 + use * GAIN_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
        delay=use * DELAY_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
    )
    too_far = condition.scale().travel_peak / LARGEST_TRAVEL
    return replace(condition, amplitude=amplitude / too_far) if too_far > 1.0 else condition


@dataclass(frozen=True, slots=True)
class DrawnExcitation:
    """Excitation of the body, drawn.

    Attributes:
        kind: one of ``KINDS``.
        low, high: Hz, where most of it lies.
        levels: relative amplitudes of equal stretches of the record.
        start, end: s, from before the record's start to its end.
        spline: acceleration over time, m/s^2, before scaling.
    """

    kind: str
    low: float
    high: float
    levels: tuple[float, ...]
    start: float
    end: float
    spline: CubicSpline

    def at(self, t: Array) -> Array:
        """Return the acceleration (m/s^2, shape of ``t``) for an amplitude of 1."""
        return np.asarray(self.spline(np.clip(t, self.start, self.end)), dtype=np.float64)


def draw_excitation(
    generator: np.random.Generator, kind: str, resonance: float, start: float, end: float
) -> DrawnExcitation:
    """Draw an excitation of ``kind`` from rest; its strongest sine or twice its rms is 1 m/s^2.

    Args:
        generator: drawn from.
        kind: one of ``KINDS``.
        resonance: natural frequency of the spool, Hz: the band begins below and ends above it.
        start: s, not above 0; at rest there.
        end: s.

    Raises:
        KeyError: there is no such kind.
    """
    t = grid(start, end)
    if kind in SHAKEN:
        low = generator.uniform(0.45, 0.75) * resonance
        high = min(generator.uniform(3.0, 5.5) * resonance, 120.0)
        shape = SHAPES[kind](generator, t - start, low, high)
        levels = _levels(generator)
        shape *= _profile(t, max(start, 0.0), end, levels)
        return risen(kind, low, high, t, shape, levels)
    low, high = generator.uniform(0.4, 0.8) * resonance, generator.uniform(60.0, 150.0)
    return risen(kind, low, high, t, SHAPES[kind](generator, t - start, low, high), rms=0.5)


def grid(start: float, end: float) -> Array:
    """Return the instants (s) at which an excitation from ``start`` to ``end`` is worked out."""
    return np.arange(start, end + 1.0 / GRID_RATE, 1.0 / GRID_RATE, dtype=np.float64)


def risen(
    kind: str,
    low: float,
    high: float,
    t: Array,
    value: Array,
    levels: tuple[float, ...] = (1.0,),
    *,
    rms: float | None = None,
) -> DrawnExcitation:
    """Return the excitation with the acceleration ``value`` at ``t`` (s) that rises from 0 over ``RISE``.

    With ``rms`` (m/s^2) it is scaled to that; other names as in ``DrawnExcitation``.
    """
    value = value * (0.5 - 0.5 * np.cos(np.pi * np.clip((t - t[0]) / RISE, 0.0, 1.0)))
    if rms is not None:
        value *= rms / value.std()
    spline = CubicSpline(t, value)
    return DrawnExcitation(kind, float(low), float(high), levels, float(t[0]), float(t[-1]), spline)


def _levels(generator: np.random.Generator) -> tuple[float, ...]:
    if generator.random() < 0.5:
        return (1.0,)
    count = int(generator.integers(2, 5))
    levels = generator.permutation(np.linspace(generator.uniform(0.3, 0.6), 1.0, count))
    return tuple(float(level) for level in levels)


def _profile(t: Array, start: float, end: float, levels: tuple[float, ...]) -> Array:
    borders = np.linspace(start, end, len(levels) + 1)[1:-1]
    profile = np.full(t.shape, levels[0])
    for border, before, after in zip(borders, levels[:-1], levels[1:], strict=True):
        share = np.clip((t - border) / FADE + 0.5, 0.0, 1.0)
        profile += (after - before) * (0.5 - 0.5 * np.cos(np.pi * share))
    return profile


def _sweep(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    length = generator.uniform(6.0, 15.0)
    there = np.abs((t / length + 1.0) % 2.0 - 1.0)  # up, then down
    linear = generator.random() < 0.5
    frequency = low + (high - low) * there if linear else low * (high / low) ** there
    return _sine(np.asarray(frequency, dtype=np.float64), t)


def _stepped(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    count = int(generator.integers(12, 25))
    steps: Array = np.geomspace(low, high, count, dtype=np.float64)
    if generator.random() < 0.5:
        steps = np.asarray(generator.permutation(steps), dtype=np.float64)
    dwell = generator.uniform(0.6, 1.5)
    return _sine(steps[(t / dwell).astype(np.int64) % count], t)


def _sine(frequency: Array, t: Array) -> Array:
    turns = np.cumsum(frequency) * (t[1] - t[0])
    return np.asarray(np.sin(2.0 * np.pi * turns))


def _multisine(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    count = int(generator.integers(25, 60))
    frequencies = np.linspace(low, high, count) + generator.uniform(-0.05, 0.05, count)
    return _lines(generator, t, frequencies, 0.5)


def _orders(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    period = generator.uniform(15.0, 40.0)
    slow = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / period)
    shaft = low + (0.45 * high - low) * slow if 0.45 * high > low else low * (1.0 + 0.3 * slow)
    total = np.zeros(t.shape)
    for order, amplitude in zip((1.0, 2.0, 3.0, 4.0), (0.55, 0.35, 0.2, 0.12), strict=True):
        total += amplitude * _sine(order * shaft, t)
    broadband = np.sort(generator.uniform(0.7 * low, high, 60))
    return total + _lines(generator, t, broadband, generator.uniform(0.15, 0.3))


def random_lines(generator: np.random.Generator, t: Array, low: float, high: float, count: int = 80) -> Array:
    """Return a sum of ``count`` sines of drawn frequencies (Hz) and phases; rms 1, shape of ``t``."""
    return _lines(generator, t, generator.uniform(low, high, count))


def _lines(generator: np.random.Generator, t: Array, frequencies: Array, rms: float = 1.0) -> Array:
    total = np.zeros(t.shape)
    for frequency, phase in zip(frequencies, generator.random(frequencies.size), strict=True):
        total += np.sin(2.0 * np.pi * (frequency * t + phase))
    return np.asarray(total * rms * np.sqrt(2.0 / frequencies.size))


#: 1/s, shaft of an idling diesel engine: 600 to 900 rpm.
IDLE_SPEED = (10.0, 15.0)
#: Orders of a four-stroke engine with four cylinders, and their relative amplitudes: the firing is order 2.
ORDERS = ((0.5, 0.15), (1.0, 0.3), (1.5, 0.12), (2.0, 1.0), (3.0, 0.15), (4.0, 0.35), (6.0, 0.15))
#: Blows a second of a hydraulic hammer, s of a burst and of a pause.
BLOWS, BURST, PAUSE = (6.0, 14.0), (1.0, 4.0), (0.5, 3.0)
#: s of work and of rest of a machine that is operated, and of the edges between.
WORK, REST, EDGE = (3.0, 10.0), (1.0, 4.0), 0.3


def _idle(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    speed = generator.uniform(*IDLE_SPEED) * (1.0 + 0.01 * random_lines(generator, t, 0.05, 1.5, 12))
    turns = np.cumsum(speed) / GRID_RATE
    total = 0.1 * random_lines(generator, t, low, high)
    for order, amplitude in ORDERS:
        course = 1.0 + 0.15 * random_lines(generator, t, 0.1, 3.0, 8)
        total += amplitude * course * np.sin(2.0 * np.pi * (order * turns + generator.random()))
    return np.asarray(total)


def _hammer(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    blows = np.zeros(t.size)
    now, end = 0.3, float(t[-1])
    while now < end:
        until = min(now + generator.uniform(*BURST), end)
        period = 1.0 / generator.uniform(*BLOWS)
        while now < until:
            blows[min(round(now * GRID_RATE), t.size - 1)] = generator.uniform(0.8, 1.2)
            now += period * generator.uniform(0.96, 1.04)
        now = until + generator.uniform(*PAUSE)
    ringing = np.arange(round(0.8 * GRID_RATE)) / GRID_RATE
    answer = np.zeros(ringing.size)
    for _ in range(int(generator.integers(3, 6))):
        turn = 2.0 * np.pi * generator.uniform(low, high)
        answer += generator.uniform(0.4, 1.0) * np.exp(-0.06 * turn * ringing) * np.sin(turn * ringing)
    return np.asarray(fftconvolve(blows, answer)[: t.size])


def _operation(generator: np.random.Generator, t: Array, low: float, high: float) -> Array:
    envelope = np.zeros(t.size)
    now, end = 0.0, float(t[-1])
    while now < end:
        work = generator.uniform(*WORK)
        rise = np.clip(np.minimum(t - now, now + work - t) / EDGE, 0.0, 1.0)
        envelope += generator.uniform(0.5, 1.0) * (0.5 - 0.5 * np.cos(np.pi * rise))
        now += work + generator.uniform(*REST)
    return np.asarray(
        envelope * (random_lines(generator, t, low, high) + 0.5 * _idle(generator, t, low, high))
    )


#: Shape of each kind: takes the generator, s since the start, and low and high frequency in Hz.
SHAPES: dict[str, Callable[[np.random.Generator, Array, float, float], Array]] = {
    "sweep": _sweep,
    "stepped_sine": _stepped,
    "multisine": _multisine,
    "machine_orders": _orders,
    IDLE: _idle,
    HAMMER: _hammer,
    OPERATION: _operation,
}
