"""A channel that clips."""

from __future__ import annotations

from spool_gap.effect import Effect


class SensorSaturation(Effect):
    """Readings pile up at a rail; those samples are left out of the fit."""

    id = "sensor_saturation"
    kinds = ("accelerations",)
    fitted = ("saturation_limit",)
    meaning = "the acceleration leaves the range of the sensor or of its amplifier"
    check = "measuring range against the largest acceleration, amplifier setting"
    picture = "samples"
    confused_with = ("end_stop",)
    told_by = "a smaller drive"

    @property
    def law(self) -> str:
        """Its law as text."""
        return "reading = min(limit, max(-limit, acceleration))"
