"""Gain error of the spool's sensor."""

from __future__ import annotations

from collections.abc import Mapping

from spool_sim.terms import Parameter

from spool_gap.effect import Array
from spool_gap.sensor_effect import SensorEffect


class SpoolGainError(SensorEffect):
    """Gain error: always part of the base within its tolerance; named beyond."""

    id = "spool_gain_error"
    parameters = (Parameter("spool_gain_error", "1", -0.5, 0.5, 0.15, "relative error of the reading"),)
    searched = False
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
        time: Array,  # noqa: ARG002
    ) -> Array:
        """Return the reading with its gain."""
        return acceleration * (1.0 + values["spool_gain_error"])
