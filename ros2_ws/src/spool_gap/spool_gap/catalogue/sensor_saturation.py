"""A channel that clips."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from spool_sim.terms import Parameter

from spool_gap.effect import Array
from spool_gap.sensor_effect import SensorEffect


class SensorSaturation(SensorEffect):
    """Saturation: readings pile up at a rail, as the checks find; those samples are left out of the fit."""

    id = "sensor_saturation"
    parameters = (Parameter("saturation_limit", "m/s^2", 0.0, 1e6, 15.0, "largest reading"),)
    searched = False
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
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the clipped reading."""
        return np.clip(acceleration, -values["saturation_limit"], values["saturation_limit"])
