"""What the spool's channel makes of an acceleration: gain, delay and a rail."""

from __future__ import annotations

import numpy as np
from spool_core.numbers import Array
from spool_estimator.identification.spectra import delayed
from spool_sim.terms import Parameter

from spool_gap.effect import SensorEffect


def gained(acceleration: Array, spool_gain_error: float) -> Array:
    return acceleration * (1.0 + spool_gain_error)


#: Always part of the base within its tolerance; named beyond. So is the delay.
SPOOL_GAIN_ERROR = SensorEffect(
    id="spool_gain_error",
    parameters=(Parameter("spool_gain_error", "1", -0.5, 0.5, 0.15, "relative error of the reading"),),
    equation="reading = (1 + g) acceleration",
    meaning="the spool's accelerometer or its amplifier reads too much or too little",
    check="calibration of both channels side by side, amplifier setting, cable, mounting",
    confusable_with=("spool_delay",),
    distinguished_by="excitation well below the resonance",
    reads=gained,
)


def late(acceleration: Array, spool_delay: float, period: float) -> Array:
    return delayed(acceleration, spool_delay, period)


SPOOL_DELAY = SensorEffect(
    id="spool_delay",
    parameters=(Parameter("spool_delay", "s", -5e-3, 5e-3, 3e-3, "time of the reading after the motion"),),
    equation="reading(t) = acceleration(t - tau)",
    meaning="the spool's channel lags behind the body's",
    check="filters of both channels, sampling order of the logger, clocks of two loggers; "
    "oil column and coils of the spring, whose lag reads alike",
    confusable_with=("spool_gain_error",),
    distinguished_by="broadband excitation",
    reads=late,
)


def clipped(acceleration: Array, saturation_limit: float) -> Array:
    return np.clip(acceleration, -saturation_limit, saturation_limit)


#: Readings pile up at a rail, as the checks find; those samples are left out of the fit.
SENSOR_SATURATION = SensorEffect(
    id="sensor_saturation",
    parameters=(Parameter("saturation_limit", "m/s^2", 0.0, 1e6, 15.0, "largest reading"),),
    equation="reading = min(limit, max(-limit, acceleration))",
    meaning="the acceleration leaves the range of the sensor or of its amplifier",
    check="measuring range against the largest acceleration, amplifier setting",
    confusable_with=("end_stop",),
    distinguished_by="a smaller excitation",
    reads=clipped,
)
