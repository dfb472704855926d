"""Delay of the spool's channel."""

from __future__ import annotations

from spool_gap.effect import Effect


class SpoolDelay(Effect):
    """Always part of the base within its tolerance; named beyond."""

    id = "spool_delay"
    kinds = ("accelerations",)
    fitted = ("spool_delay",)
    meaning = "the spool's channel lags behind the body's"
    check = "filters of both channels, sampling order of the logger, clocks of two loggers"
    picture = "samples"
    confused_with = ("spool_gain_error",)
    told_by = "broadband drive"

    @property
    def law(self) -> str:
        """Its law as text."""
        return "reading(t) = acceleration(t - tau)"
