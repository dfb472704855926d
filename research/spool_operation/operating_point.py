"""Operating point of a valve on its machine, and the machine that shakes it so."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from spool_core.numbers import Array
from spool_evaluation.monitor_cases.scenario import StoppingMachine
from spool_sim.sensors import Sensor
from spool_sim.valve import Valve

#: Scales that make distances of features alike: a factor of e in damping, half a natural frequency in speed,
#: a factor of e in friction over force, and in noise over vibration.
SCALES = np.array([1.0, 0.5, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Measuring:
    """Measuring chain of one valve: both accelerometers and the sample rate (Hz)."""

    sample_rate: float
    noise: float
    resolution: float
    gain_error: float
    bias: float

    @property
    def body(self) -> Sensor:
        """The body's accelerometer."""
        return Sensor(noise=self.noise, resolution=self.resolution)

    @property
    def spool(self) -> Sensor:
        """The spool's accelerometer."""
        return Sensor(
            noise=self.noise, resolution=self.resolution, gain_error=self.gain_error, bias=self.bias
        )


@dataclass(frozen=True, slots=True)
class Shaking:
    """Shaking of a machine: shares of its orders (1/rev), and of the rest, m/s^2.

    ``first`` is the amplitude of the first order, ``second`` and ``fourth`` are shares of it, ``broadband``
    the rms of the rest over it.
    """

    first: float
    second: float
    fourth: float
    broadband: float
    seed: int

    def machine(
        self, profile: tuple[tuple[float, float], ...], rests: tuple[tuple[float, float], ...] = ()
    ) -> StoppingMachine:
        """Return the machine that runs through ``profile`` (s, shaft frequency in Hz)."""
        orders: tuple[tuple[float, float], ...] = ((1.0, self.first), (2.0, self.second * self.first))
        if self.fourth > 0.0:
            orders = (*orders, (4.0, self.fourth * self.first))
        return StoppingMachine(
            speed_profile=tuple((time, 60.0 * frequency) for time, frequency in profile),
            orders=orders,
            broadband_rms=self.broadband * self.first,
            broadband_low=6.0,
            broadband_high=75.0,
            broadband_lines=16,
            seed=self.seed,
            rests=rests,
        )


def features(
    valve: Valve, viscous: float, coulomb: float, shaft: float, shaking: Shaking, noise: float
) -> Array:
    """Return what the quality of estimates depends on, shape (4,).

    Logarithm of the damping ratio, shaft over natural frequency, logarithms of dry friction over the first
    order's inertia force and of noise over its amplitude.
    """
    ratio = viscous / (2.0 * math.sqrt(valve.spring_stiffness * valve.moving_mass))
    force = valve.moving_mass * shaking.first
    return np.array(
        [
            math.log(ratio),
            shaft / valve.natural_frequency,
            math.log(max(coulomb, 1e-3) / force),
            math.log(noise / shaking.first),
        ]
    )


def draw_measuring(draw: np.random.Generator) -> Measuring:
    """Return a measuring chain: noise of piezoelectric and MEMS sensors, 12 to 16 bit, gain errors to 2 %."""
    return Measuring(
        sample_rate=float(draw.choice([800.0, 1000.0, 1250.0, 2000.0])),
        noise=float(draw.uniform(0.02, 0.1)),
        resolution=float(draw.choice([0.0, 0.002, 0.02])),
        gain_error=float(draw.uniform(-0.02, 0.02)),
        bias=float(draw.uniform(-0.2, 0.2)),
    )


def draw_shaking(draw: np.random.Generator, *, below: bool) -> Shaking:
    """Return how a machine shakes that runs below or above the valve's natural frequency."""
    return Shaking(
        first=float(draw.uniform(2.5, 10.0)),
        second=float(draw.uniform(0.2, 0.5)),
        fourth=0.2 if below else 0.0,
        broadband=float(draw.uniform(0.08, 0.3)),
        seed=int(draw.integers(2**31)),
    )
