"""Excitation by the body: sweep, stepped sine, multisine, machine orders with broadband."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

KINDS = ("sweep", "stepped_sine", "multisine", "machine_orders")
#: Hz at which an excitation is worked out; a cubic spline through it errs by 1e-6 at 150 Hz.
GRID_RATE = 8000.0
#: s over which an excitation rises from rest.
RISE = 0.5
#: s between two levels.
FADE = 0.4


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
    t: Array = np.arange(start, end + 1.0 / GRID_RATE, 1.0 / GRID_RATE, dtype=np.float64)
    low = generator.uniform(0.45, 0.75) * resonance
    high = generator.uniform(3.0, 5.5) * resonance
    high = float(min(high, 120.0))
    shape = {
        "sweep": _sweep,
        "stepped_sine": _stepped,
        "multisine": _multisine,
        "machine_orders": _orders,
    }[kind](generator, t - start, low, high)
    levels = _levels(generator)
    value = shape * _profile(t, max(start, 0.0), end, levels)
    rise = np.clip((t - start) / RISE, 0.0, 1.0)
    value *= 0.5 - 0.5 * np.cos(np.pi * rise)
    return DrawnExcitation(kind, float(low), high, levels, float(t[0]), float(t[-1]), CubicSpline(t, value))


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


def _lines(generator: np.random.Generator, t: Array, frequencies: Array, rms: float) -> Array:
    total = np.zeros(t.shape)
    for frequency, phase in zip(frequencies, generator.random(frequencies.size), strict=True):
        total += np.sin(2.0 * np.pi * (frequency * t + phase))
    return np.asarray(total * rms * np.sqrt(2.0 / frequencies.size))
