"""Faults of a measuring chain that the gap workflow's model has no part for: a second family of field cases.

Every record of this family has one of them and nothing else. Which kinds choices may be made on and which are
for the report differ: a method that was fitted to one fault is not right because it knows that fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.fft import rfftfreq

from spool_blind.field.nuisances import (
    CHANNELS,
    SPOOL,
    AcCoupling,
    Array,
    CrossAxis,
    FieldNuisance,
    Generator,
    Jitter,
    MainsHum,
    Quantisation,
    Seen,
    coloured,
    log_between,
    new_seed,
)

#: Seeds of this family: choices may be made on the first, the second are for the report.
DEVELOPMENT, REPORT = range(410_000, 410_100), range(530_000, 530_100)


@dataclass(frozen=True)
class PinkNoise(FieldNuisance):
    """Noise of both sensors whose power falls as 1/f; sizes are its rms."""

    id = "pink_noise"
    unit = "m/s^2"
    stage = 20

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw its rms, 0.5 to 5 % of the readings."""
        share = log_between(generator, 0.005, 0.05)
        return cls({name: share * seen.rms[name] for name in CHANNELS}, new_seed(generator))

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the noise, of each channel by itself."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        power = 1.0 / np.maximum(frequency, 0.3)
        return self.sizes[channel] * coloured(self.random(channel), power, reading.size)


@dataclass(frozen=True)
class LowPassedNoise(FieldNuisance):
    """Noise of the spool's sensor below a corner; sizes are its rms."""

    id = "low_passed_noise"
    unit = "m/s^2"
    stage = 20
    corner: float = 30.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw its rms, 1 to 10 % of the reading, and a corner of 15 to 60 Hz."""
        size = log_between(generator, 0.01, 0.1) * seen.rms[SPOOL]
        return cls({SPOOL: size}, new_seed(generator), corner=log_between(generator, 15.0, 60.0))

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the noise."""
        frequency = rfftfreq(reading.size, 1.0 / rate)
        power = 1.0 / (1.0 + (frequency / self.corner) ** 4)
        return self.sizes[channel] * coloured(self.random(channel), power, reading.size)


@dataclass(frozen=True)
class LateralVibration(CrossAxis):
    """Vibration across the axis that both sensors read, each with its own share of either sign."""

    id = "lateral_vibration"

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw both shares, 1 to 6 % of the body's acceleration, of either sign, and the band."""
        sizes = {
            name: log_between(generator, 0.01, 0.06) * seen.rms["body"] * float(generator.choice([-1.0, 1.0]))
            for name in CHANNELS
        }
        high = float(min(generator.uniform(1.0, 3.0) * seen.high, 0.4 * seen.rate))
        return cls(sizes, new_seed(generator), low=0.5 * seen.low, high=high)


@dataclass(frozen=True)
class MachineMode(LateralVibration):
    """Lateral vibration of a machine that rings at a mode, driven at random; ``low`` is its frequency, Hz."""

    id = "machine_mode"
    damping: float = 0.01

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw shares as above, a mode within the band of the excitation or close above, and its damping."""
        lateral = LateralVibration.draw(generator, seen)
        mode = float(generator.uniform(seen.low, min(2.0 * seen.high, 0.3 * seen.rate)))
        return cls(lateral.sizes, lateral.seed, low=mode, damping=log_between(generator, 0.003, 0.03))

    def disturbance(self, channel: str, reading: Array, rate: float) -> Array:
        """Return the ringing."""
        ratio = rfftfreq(reading.size, 1.0 / rate) / self.low
        power = 1.0 / ((1.0 - ratio**2) ** 2 + (2.0 * self.damping * ratio) ** 2)
        return self.sizes[channel] * coloured(np.random.default_rng(self.seed), power, reading.size)


@dataclass(frozen=True)
class DifferentCorners(AcCoupling):
    """AC coupling of both channels with corners that differ by a factor of two or more."""

    id = "different_corners"

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:  # noqa: ARG003
        """Draw both corners."""
        lower = log_between(generator, 0.2, 1.0)
        corners = [lower, lower * float(generator.uniform(2.0, 4.0))]
        generator.shuffle(corners)
        return cls(dict(zip(CHANNELS, corners, strict=True)), new_seed(generator))


@dataclass(frozen=True)
class StrongJitter(Jitter):
    """Jitter of both channels by 30 to 200 us."""

    id = "strong_jitter"

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw its rms, a third of a period at most."""
        rms = min(log_between(generator, 30e-6, 200e-6), 0.3 / seen.rate)
        return cls(dict.fromkeys(CHANNELS, rms), new_seed(generator))


@dataclass(frozen=True)
class RectifierHum(MainsHum):
    """Hum of one channel with many harmonics, as a rectifier makes it."""

    id = "rectifier_hum"

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw amplitude and harmonics up to the eleventh."""
        name = str(generator.choice(list(CHANNELS)))
        falls = [float(generator.uniform(0.3, 1.0)) / order for order in range(1, 12)]
        mains = float(generator.choice([50.0, 60.0])) * float(1.0 + generator.uniform(-8e-4, 8e-4))
        size = log_between(generator, 0.01, 0.1) * seen.rms[name]
        return cls({name: size}, new_seed(generator), frequency=mains, harmonics=tuple(falls))


@dataclass(frozen=True)
class BentSensor(FieldNuisance):
    """The spool's sensor is not quite linear: squares and cubes; the size is their share at the rms."""

    id = "bent_sensor"
    unit = "1"
    stage = 25
    cube: float = 0.0

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:  # noqa: ARG003
        """Draw both shares, 0.1 to 1 %, of either sign."""
        square, cube = (
            log_between(generator, 0.001, 0.01) * float(generator.choice([-1.0, 1.0])) for _ in range(2)
        )
        return cls({SPOOL: square}, new_seed(generator), cube=0.3 * cube)

    def on_reading(self, channel: str, reading: Array, time: Array) -> Array:  # noqa: ARG002
        """Return what the sensor makes of the motion."""
        rms = float(reading.std())
        seen = reading / rms
        return np.asarray(rms * (seen + self.sizes[channel] * seen**2 + self.cube * seen**3))


@dataclass(frozen=True)
class CoarseSteps(Quantisation):
    """Both channels are stored as integers of a coarse step: 8 to 40 steps within the rms."""

    id = "coarse_steps"

    @classmethod
    def draw(cls, generator: Generator, seen: Seen) -> FieldNuisance:
        """Draw the step of both channels."""
        step = min(seen.rms.values()) / log_between(generator, 8.0, 40.0)
        return cls(dict.fromkeys(CHANNELS, step), new_seed(generator))


#: Kinds that choices may be made on, and those for the report.
FOREIGN: Mapping[range, tuple[type[FieldNuisance], ...]] = {
    DEVELOPMENT: (PinkNoise, LateralVibration, DifferentCorners, StrongJitter),
    REPORT: (LowPassedNoise, MachineMode, RectifierHum, BentSensor, CoarseSteps),
}
KINDS: dict[str, type[FieldNuisance]] = {kind.id: kind for kinds in FOREIGN.values() for kind in kinds}


def foreign_names(seed: int) -> tuple[str, ...] | None:
    """Return the fault of the case of ``seed``: all kinds in turn; ``None`` for seeds of no such case."""
    for seeds, kinds in FOREIGN.items():
        if seed in seeds:
            # What is hidden repeats every twelve seeds: each kind meets all of it.
            return (kinds[sum(divmod(seed, 12)) % len(kinds)].id,)
    return None
