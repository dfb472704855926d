"""Nuisances that add to a reading: hum, bias and drift, spikes, lateral vibration, coloured noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfftfreq

from .nuisance import FieldNuisance, Generator, Seen, draw_channels, log_between, new_seed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MainsHum(FieldNuisance):
    """Mains hum: the mains' frequency, which strays a little, and harmonics that fall off.

    ``frequency`` in Hz; ``harmonics`` are relative amplitudes from the fundamental on; sizes are amplitudes
    of the fundamental.
    """

    id = "hum"
    unit = "m/s^2"
    stage = 30
    frequency: float = 50.0
    harmonics: tuple[float, ...] = (1.0,)

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw amplitude, mains and harmonics."""
        share = log_between(generator, 0.005, 0.2)
        mains = float(generator.choice([50.0, 60.0]))
        fall = generator.uniform(0.0, 0.6, int(generator.integers(0, 6)))
        # Rectifiers and transformers give odd harmonics above all.
        odd = [float(one) * (1.0 if order % 2 else 0.3) for order, one in enumerate(fall, start=2)]
        return cls(
            {name: share * seen.rms[name] for name in draw_channels(generator)},
            new_seed(generator),
            frequency=mains * float(1.0 + generator.uniform(-8e-4, 8e-4)),
            harmonics=(1.0, *odd),
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with the lines."""
        generator = self.random(channel)
        # Hz; the grid's frequency wanders by some hundredths over a minute.
        turns = self.frequency * time + 0.3 * np.sin(2.0 * np.pi * (time / 80.0 + generator.random()))
        total = np.zeros(reading.size)
        for order, share in enumerate(self.harmonics, start=1):
            total += share * np.sin(2.0 * np.pi * (order * turns + generator.random()))
        return np.asarray(reading + self.sizes[channel] * total)


@dataclass(frozen=True)
class BiasDrift(FieldNuisance):
    """Bias that drifts slowly, along a line or while it warms; sizes are its change over the record.

    ``bias`` is its beginning, by channel, m/s^2; ``constant`` the time constant in records, 0 for a line.
    """

    id = "bias_drift"
    unit = "m/s^2"
    stage = 50
    bias: Mapping[str, float] | None = None
    constant: float = 0.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw bias and drift."""
        sign = float(generator.choice([-1.0, 1.0]))
        channels = draw_channels(generator)
        return cls(
            {name: sign * log_between(generator, 0.005, 0.2) * seen.rms[name] for name in channels},
            new_seed(generator),
            bias={name: float(generator.uniform(-0.2, 0.2)) * seen.rms[name] for name in channels},
            constant=float(generator.choice([0.0, generator.uniform(0.2, 0.6)])),
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with its bias."""
        beginning = (self.bias or {}).get(channel, 0.0)
        return np.asarray(reading + beginning + self.sizes[channel] * course(time, self.constant))


@dataclass(frozen=True)
class Spikes(FieldNuisance):
    """Spikes of one to three samples at random instants; sizes are their number per second.

    ``height`` is their median, by channel, m/s^2.
    """

    id = "spikes"
    unit = "1/s"
    stage = 60
    height: Mapping[str, float] | None = None

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw rate and height."""
        channels = draw_channels(generator)
        rate = log_between(generator, 0.05, 2.0)
        share = log_between(generator, 3.0, 30.0)
        return cls(
            dict.fromkeys(channels, rate),
            new_seed(generator),
            height={name: share * seen.rms[name] for name in channels},
        )

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:
        """Return the reading with spikes."""
        generator = self.random(channel)
        count = int(generator.poisson(self.sizes[channel] * (time[-1] - time[0])))
        spiked = reading.copy()
        for place in generator.integers(0, reading.size, count):
            height = (self.height or {})[channel] * float(np.exp(0.4 * generator.standard_normal()))
            spiked[place : place + int(generator.integers(1, 4))] += height * generator.choice([-1.0, 1.0])
        return spiked


@dataclass(frozen=True)
class CrossAxis(FieldNuisance):
    """Cross-axis sensitivity: vibration across the axis, which is not the motion; sizes are its rms.

    ``low`` and ``high`` in Hz are the band of the lateral vibration.
    """

    id = "cross_axis"
    unit = "m/s^2"
    stage = 10
    low: float = 10.0
    high: float = 100.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw sensitivity (1 to 5 %) and lateral vibration (0.3 to 1.5 of the body's)."""
        across = generator.uniform(0.3, 1.5) * seen.rms["body"]
        low = float(generator.uniform(0.5, 1.0) * seen.low)
        return cls(
            {name: float(generator.uniform(0.01, 0.05)) * across for name in draw_channels(generator)},
            new_seed(generator),
            low=low,
            high=float(min(generator.uniform(0.7, 2.0) * seen.high, 0.4 * seen.rate)),
        )

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the part of the lateral vibration: the same in both channels but for its size."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        inside = ((frequency >= self.low) & (frequency <= self.high)).astype(np.float64)
        return self.sizes[channel] * coloured(np.random.default_rng(self.seed), inside, reading.size)


@dataclass(frozen=True)
class ColouredNoise(FieldNuisance):
    """Coloured noise of the sensor: 1/f below a corner, or one band; sizes are its rms.

    ``low`` and ``high`` in Hz are the band; ``low`` 0: power falls as 1/f up to ``high``.
    """

    id = "coloured_noise"
    unit = "m/s^2"
    stage = 20
    low: float = 0.0
    high: float = 50.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw colour and rms."""
        share = log_between(generator, 0.003, 0.03)
        pink = generator.random() < 0.5
        low = 0.0 if pink else log_between(generator, 5.0, 0.1 * seen.rate)
        return cls(
            {name: share * seen.rms[name] for name in draw_channels(generator)},
            new_seed(generator),
            low=float(low),
            high=float(generator.uniform(100.0, 400.0) if pink else low * generator.uniform(1.5, 4.0)),
        )

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the noise."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        inside = (frequency >= self.low) & (frequency <= self.high)
        # 1/f from 0.1 Hz on: below that it is a bias.
        power = inside / np.maximum(frequency, 0.1) if self.low == 0.0 else inside.astype(np.float64)
        return self.sizes[channel] * coloured(self.random(channel), power, reading.size)


def coloured(generator: Generator, power: Array, size: int) -> Array:
    """Return normal noise of rms 1, shape (size,), whose power has the shape ``power`` (size // 2 + 1,)."""
    lines = generator.standard_normal((2, power.size))
    row = irfft(np.sqrt(power) * (lines[0] + 1j * lines[1]), size)
    return np.asarray(row / row.std())


def course(time: Array, constant: float) -> Array:
    """Return a change from 0 to 1 over the record: linear, or towards 1 with ``constant`` records."""
    share = (time - time[0]) / (time[-1] - time[0])
    if constant <= 0.0:
        return np.asarray(share)
    return np.asarray((1.0 - np.exp(-share / constant)) / (1.0 - np.exp(-1.0 / constant)))
