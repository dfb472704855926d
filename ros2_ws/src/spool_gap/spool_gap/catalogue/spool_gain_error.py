"""Gain error of the spool's sensor."""

from __future__ import annotations

from spool_gap.effect import Effect


class SpoolGainError(Effect):
    """Always part of the base within its tolerance; named beyond."""

    id = "spool_gain_error"
    kinds = ("accelerations",)
    fitted = ("spool_gain_error",)
    meaning = "the spool's accelerometer or its amplifier reads too much or too little"
    check = "calibration of both channels side by side, amplifier setting, cable, mounting"
    picture = "samples"
    confused_with = ("spool_delay",)
    told_by = "drive well below the resonance"

    @property
    def law(self) -> str:
        """Its law as text."""
        return "reading = (1 + g) acceleration"
