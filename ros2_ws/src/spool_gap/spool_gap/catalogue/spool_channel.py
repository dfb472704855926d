"""What the spool's channel makes of an acceleration: gain, delay and a rail."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.spectra import delayed
from spool_sim.terms import Parameter

from spool_gap.effect import SensorEffect


class SpoolGainError(SensorEffect):
    """Gain error: always part of the base within its tolerance; named beyond."""

    id = "spool_gain_error"
    parameters = (Parameter("spool_gain_error", "1", -0.5, 0.5, 0.15, "relative error of the reading"),)
    equation = "reading = (1 + g) acceleration"
    meaning = "the spool's accelerometer or its amplifier reads too much or too little"
    check = "calibration of both channels side by side, amplifier setting, cable, mounting"
    confusable_with = ("spool_delay",)
    distinguished_by = "excitation well below the resonance"

    def reading(
        self,
        acceleration: Array,
        period: float,  # noqa: ARG002
        values: Mapping[str, float],
    ) -> Array:
        """Return the reading with its gain."""
        return acceleration * (1.0 + values["spool_gain_error"])


class SpoolDelay(SensorEffect):
    """Delay: always part of the base within its tolerance; named beyond."""

    id = "spool_delay"
    parameters = (Parameter("spool_delay", "s", -5e-3, 5e-3, 3e-3, "time of the reading after the motion"),)
    equation = "reading(t) = acceleration(t - tau)"
    meaning = "the spool's channel lags behind the body's"
    check = "filters of both channels, sampling order of the logger, clocks of two loggers"
    confusable_with = ("spool_gain_error",)
    distinguished_by = "broadband excitation"

    def reading(self, acceleration: Array, period: float, values: Mapping[str, float]) -> Array:
        """Return the delayed reading."""
        return delayed(acceleration, values["spool_delay"], period)


class SensorSaturation(SensorEffect):
    """Saturation: readings pile up at a rail, as the checks find; those samples are left out of the fit."""

    id = "sensor_saturation"
    parameters = (Parameter("saturation_limit", "m/s^2", 0.0, 1e6, 15.0, "largest reading"),)
    equation = "reading = min(limit, max(-limit, acceleration))"
    meaning = "the acceleration leaves the range of the sensor or of its amplifier"
    check = "measuring range against the largest acceleration, amplifier setting"
    confusable_with = ("end_stop",)
    distinguished_by = "a smaller excitation"

    def reading(
        self,
        acceleration: Array,
        period: float,  # noqa: ARG002
        values: Mapping[str, float],
    ) -> Array:
        """Return the clipped reading."""
        return np.clip(acceleration, -values["saturation_limit"], values["saturation_limit"])
