"""Experiment condition of a field case: what machine, logger and valve are, and how the machine moves.

The kinds of :mod:`spool_blind.condition` are drawn besides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve

from spool_blind.condition import (
    AMPLITUDE,
    DELAY_TOLERANCE,
    GAIN_TOLERANCE,
    GRID_RATE,
    KINDS,
    LARGEST_TRAVEL,
    MASS,
    NUISANCE_SHARE,
    NUISANCE_USE,
    RISE,
    SOFT,
    STIFF,
    VISCOUS,
    DrawnExcitation,
    ExperimentCondition,
    draw_excitation,
)
from spool_blind.simulator.plant import AFTER, Plant

#: Hz, s, and rms of white noise over that of the channel's acceleration.
RATES = (1000.0, 1250.0, 2000.0, 2500.0, 4000.0, 5000.0, 8000.0, 10_000.0)
DURATION = (20.0, 60.0)
NOISE = (0.002, 0.02)

Array = NDArray[np.float64]
Generator = np.random.Generator

IDLE, HAMMER, OPERATION = "engine_idle", "hammer_bursts", "operation_with_pauses"
FIELD_KINDS = (*KINDS, IDLE, HAMMER, OPERATION)
#: 1/s, shaft of an idling diesel engine: 600 to 900 rpm.
IDLE_SPEED = (10.0, 15.0)
#: Orders of a four-stroke engine with four cylinders, and their relative amplitudes: the firing is order 2.
ORDERS = ((0.5, 0.15), (1.0, 0.3), (1.5, 0.12), (2.0, 1.0), (3.0, 0.15), (4.0, 0.35), (6.0, 0.15))
#: Blows a second of a hydraulic hammer, s of a burst and of a pause.
BLOWS, BURST, PAUSE = (6.0, 14.0), (1.0, 4.0), (0.5, 3.0)
#: s of work and of rest of a machine that is operated, and of the edges between.
WORK, REST, EDGE = (3.0, 10.0), (1.0, 4.0), 0.3


def draw_field_condition(generator: np.random.Generator, *, from_rest: bool = False) -> ExperimentCondition:
    """Draw a condition whose travel stays within the stroke wherever the least amplitude allows it.

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
    before = float(generator.choice([0.0, 1.0]))
    before = 0.0 if from_rest else before
    kind = str(generator.choice(list(FIELD_KINDS)))
    use = NUISANCE_USE if generator.random() < NUISANCE_SHARE else 0.0
    condition = ExperimentCondition(
        base=Plant(numbers),
        nominal_stiffness=nominal,
        excitation=draw_field_excitation(generator, kind, resonance, -before, duration + AFTER),
        amplitude=float(np.exp(generator.uniform(*np.log(AMPLITUDE)))),
        sample_rate=float(generator.choice(list(RATES))),
        duration=duration,
        before=before,
        noise_share=float(np.exp(generator.uniform(*np.log(NOISE)))),
        gain=1.0 + use * GAIN_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
        delay=use * DELAY_TOLERANCE * float(generator.uniform(-1.0, 1.0)),
    )
    too_far = condition.scale().travel_peak / LARGEST_TRAVEL
    return replace(condition, amplitude=condition.amplitude / max(too_far, 1.0))


def draw_field_excitation(
    generator: Generator, kind: str, resonance: float, start: float, end: float
) -> DrawnExcitation:
    """Draw an excitation of ``kind`` from rest; its strongest sine or twice its rms is 1 m/s^2.

    Args:
        generator: drawn from.
        kind: one of ``FIELD_KINDS``.
        resonance: natural frequency of the spool, Hz.
        start: s, not above 0; at rest there.
        end: s.

    Raises:
        KeyError: there is no such kind.
    """
    if kind in KINDS:
        return draw_excitation(generator, kind, resonance, start, end)
    t: Array = np.arange(start, end + 1.0 / GRID_RATE, 1.0 / GRID_RATE, dtype=np.float64)
    low = float(generator.uniform(0.4, 0.8) * resonance)
    high = float(generator.uniform(60.0, 150.0))
    shape = {IDLE: _idle, HAMMER: _hammer, OPERATION: _operation}[kind](generator, t - start, low, high)
    shape = shape * (0.5 - 0.5 * np.cos(np.pi * np.clip((t - start) / RISE, 0.0, 1.0)))
    shape *= 0.5 / shape.std()
    return DrawnExcitation(kind, low, high, (1.0,), float(t[0]), float(t[-1]), CubicSpline(t, shape))


def random_lines(generator: Generator, t: Array, low: float, high: float, count: int = 80) -> Array:
    """Return a sum of ``count`` sines of drawn frequencies (Hz) and phases; rms 1, shape of ``t``."""
    total = np.zeros(t.shape)
    for frequency, phase in zip(generator.uniform(low, high, count), generator.random(count), strict=True):
        total += np.sin(2.0 * np.pi * (frequency * t + phase))
    return np.asarray(total * np.sqrt(2.0 / count))


def _idle(generator: Generator, t: Array, low: float, high: float) -> Array:
    speed = generator.uniform(*IDLE_SPEED) * (1.0 + 0.01 * random_lines(generator, t, 0.05, 1.5, 12))
    turns = np.cumsum(speed) / GRID_RATE
    total = 0.1 * random_lines(generator, t, low, high)
    for order, amplitude in ORDERS:
        course = 1.0 + 0.15 * random_lines(generator, t, 0.1, 3.0, 8)
        total += amplitude * course * np.sin(2.0 * np.pi * (order * turns + generator.random()))
    return np.asarray(total)


def _hammer(generator: Generator, t: Array, low: float, high: float) -> Array:
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


def _operation(generator: Generator, t: Array, low: float, high: float) -> Array:
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
