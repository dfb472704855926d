"""What an accelerometer makes of an acceleration."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from .validation import NotNegative, Number

Array = NDArray[np.float64]


class Sensor(BaseModel):
    """Errors of one accelerometer. Frozen.

    Attributes:
        gain_error: relative, 0.05 reads 5 % too much.
        bias: m/s^2.
        noise: rms of white noise, m/s^2.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    gain_error: Annotated[Number, Field(gt=-1.0, le=10.0)] = 0.0
    bias: Number = 0.0
    noise: NotNegative = 0.0


class SensorChannel:
    """A sensor that is read sample after sample; its noise does not depend on how reads are split."""

    def __init__(self, sensor: Sensor, seed: int | np.random.SeedSequence) -> None:
        self.sensor = sensor
        self._generator = np.random.default_rng(seed)

    def read(self, acceleration: Array) -> Array:
        """Return the reading (m/s^2, shape (n,)) of the next n samples."""
        reading = (1.0 + self.sensor.gain_error) * acceleration + self.sensor.bias
        if self.sensor.noise > 0.0:
            reading += self.sensor.noise * self._generator.standard_normal(acceleration.size)
        return reading
