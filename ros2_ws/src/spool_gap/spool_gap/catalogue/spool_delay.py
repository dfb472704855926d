"""Delay of the spool's channel."""

from __future__ import annotations

from collections.abc import Mapping

from spool_estimator.identification.spectra import delayed
from spool_sim.terms import Parameter

from spool_gap.effect import Array
from spool_gap.sensor_effect import SensorEffect


class SpoolDelay(SensorEffect):
    """Delay: always part of the base within its tolerance; named beyond."""

    id = "spool_delay"
    parameters = (Parameter("spool_delay", "s", -5e-3, 5e-3, 3e-3, "time of the reading after the motion"),)
    searched = False
    equation = "reading(t) = acceleration(t - tau)"
    meaning = "the spool's channel lags behind the body's"
    check = "filters of both channels, sampling order of the logger, clocks of two loggers"
    confusable_with = ("spool_gain_error",)
    distinguished_by = "broadband excitation"

    def reading(
        self,
        acceleration: Array,
        period: float,
        values: Mapping[str, float],
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the delayed reading."""
        return delayed(acceleration, values["spool_delay"], period)
