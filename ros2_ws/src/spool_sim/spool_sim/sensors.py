"""Accelerometers and their measuring chain: what they make of an acceleration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError
from spool_core.errors import InputError
from spool_core.numbers import Array

from spool_sim.observation import INSTANTS, Observation
from spool_sim.valve import NotNegative, Number, Positive, one_line, read_mapping

#: Samples that one delayed sample is interpolated from (polynomial of degree 5).
_NODES = 6


def _observation(given: Any) -> Any:
    try:
        return Observation.of(given) if isinstance(given, str) else given
    except InputError as error:
        raise ValueError(str(error)) from None


class Sensor(BaseModel):
    """Errors of one accelerometer, in the order in which they act. Frozen.

    Attributes:
        filter: how the logger reads; a text as ``Observation.of`` takes it, such as ``linear`` or
            ``causal,4,0.36``. Its own noise passes no filter.
        delay_samples: delay behind the true acceleration, in samples, whole or not.
        gain_error: relative, 0.05 reads 5 % too much.
        bias: m/s^2.
        noise: rms of white noise, m/s^2.
        resolution: step of the digitised reading, m/s^2; 0 for none.
        full_scale: largest reading, m/s^2: beyond it the reading is clipped on both sides.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    filter: Annotated[Observation, BeforeValidator(_observation), PlainSerializer(str)] = Observation()
    delay_samples: Annotated[NotNegative, Field(le=100_000.0)] = 0.0
    gain_error: Annotated[Number, Field(gt=-1.0, le=10.0)] = 0.0
    bias: Number = 0.0
    noise: NotNegative = 0.0
    resolution: NotNegative = 0.0
    full_scale: Positive | None = None

    @property
    def filter_delay(self) -> float:
        """The part of ``delay_samples`` that the filter makes: what is not whole; 0 without a filter."""
        return 0.0 if self.filter.kind == INSTANTS else self.delay_samples % 1.0


class SensorChannel:
    """A sensor read sample after sample; readings do not depend on how reads are split."""

    def __init__(self, sensor: Sensor, seed: int | np.random.SeedSequence) -> None:
        self.sensor = sensor
        self._generator = np.random.default_rng(seed)
        self._delay = FractionalDelay(sensor.delay_samples - sensor.filter_delay)

    def read(self, acceleration: Array) -> Array:
        """Return the reading (m/s^2, shape (n,)) of the next n samples, filtered already."""
        sensor = self.sensor
        reading: Array = (1.0 + sensor.gain_error) * self._delay.apply(acceleration) + sensor.bias
        if sensor.noise > 0.0:
            reading += sensor.noise * self._generator.standard_normal(acceleration.size)
        if sensor.resolution > 0.0:
            reading = np.rint(reading / sensor.resolution) * sensor.resolution
        if sensor.full_scale is not None:
            reading = np.clip(reading, -sensor.full_scale, sensor.full_scale)
        return reading


class FractionalDelay:
    """By any number of samples, causal, over a signal that comes in pieces.

    A polynomial of degree 5 through six past samples, centred around the delayed instant where the delay is
    2 samples or more. Before the first sample the signal is taken as zero.
    """

    def __init__(self, samples: float) -> None:
        nearest = max(0, math.floor(samples) - (_NODES // 2 - 1))
        whole = samples == math.floor(samples)
        places = [math.floor(samples)] if whole else [nearest + node for node in range(_NODES)]
        # Lagrange's weights.
        self._taps = [
            (place, math.prod((samples - other) / (place - other) for other in places if other != place))
            for place in places
        ]
        self._history: Array = np.zeros(max(places))

    def apply(self, signal: Array) -> Array:
        """Return the delayed signal, shape (n,), at the next n samples."""
        known = np.concatenate((self._history, np.asarray(signal, dtype=np.float64)))
        before = self._history.size
        delayed: Array = np.zeros(signal.size)
        for place, weight in self._taps:
            delayed += weight * known[before - place : before - place + signal.size]
        self._history = known[known.size - before :]
        return delayed


class MeasuringChain(BaseModel):
    """A = a_acc K1 K2, the paper's equations (30) to (32). Frozen.

    Attributes:
        accelerometer: relative uncertainty of the accelerometer.
        conditioner: relative error of the signal conditioner's gain K1.
        oscilloscope: relative error of the oscilloscope's gain K2.
        conditioner_gain, oscilloscope_gain: K1 and K2, of any unit that makes a reading of a_acc.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    accelerometer: Annotated[NotNegative, Field(lt=1.0)]
    conditioner: Annotated[NotNegative, Field(lt=1.0)]
    oscilloscope: Annotated[NotNegative, Field(lt=1.0)]
    conditioner_gain: Positive = 1.0
    oscilloscope_gain: Positive = 1.0

    def reading(self, sensed: Array) -> Array:
        """Return a = a_acc K1 K2, equation (30), shape of ``sensed``."""
        return np.asarray(sensed * self.conditioner_gain * self.oscilloscope_gain)

    def uncertainty(self, sensed: Array) -> Array:
        """Return the largest error of the reading, equation (31), shape of ``sensed``; never negative.

        The print adds the three parts with their signs; a bound needs their absolute values.
        """
        gain = self.conditioner_gain * self.oscilloscope_gain
        parts = (self.accelerometer, self.conditioner, self.oscilloscope)
        return np.asarray(sum(np.abs(sensed) * gain * part for part in parts))

    @property
    def relative_uncertainty(self) -> float:
        """Largest relative error, equation (32): the sum of the three."""
        return self.accelerometer + self.conditioner + self.oscilloscope

    def sensor(self, generator: np.random.Generator, *, noise: float = 0.0) -> Sensor:
        """Return a sensor whose gain error is drawn, each of the three parts evenly within its bounds."""
        parts = np.array([self.accelerometer, self.conditioner, self.oscilloscope])
        return Sensor(gain_error=float(generator.uniform(-parts, parts).sum()), noise=noise)


#: The paper prints the sum, 5 %, only; how it is shared out is an assumption and does not enter the sum.
PAPER_CHAIN = MeasuringChain(accelerometer=0.01, conditioner=0.01, oscilloscope=0.03)


class Sensors(BaseModel):
    """The two accelerometers of a valve. Frozen."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    body: Sensor = Sensor()
    spool: Sensor = Sensor()


def load_sensors(path: str | Path) -> Sensors:
    """Return the sensors that a YAML file describes: ``body`` and ``spool``, each with keys of ``Sensor``.

    Raises:
        InputError: file unreadable, unknown key, or a value out of range.
    """
    try:
        return Sensors.model_validate(read_mapping(path, "sensors"))
    except ValidationError as error:
        raise one_line(error, str(path)) from None
