"""Clocks of two sensors: what one shows more than the other."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """What the spool's clock shows more than the body's, and how much faster it runs.

    ``offset`` in s at the body's first sample, ``drift`` relative, each with its standard deviation;
    ``coherence``: squared, over the band of both channels. ``natural_frequency`` (Hz): of the spool, by
    the way.
    """

    offset: float
    offset_std: float
    drift: float
    drift_std: float
    coherence: float
    natural_frequency: float

    def __str__(self) -> str:
        """What it is, for people."""
        return (
            f"the spool's clock shows {self.offset:+.5f} s (std {1e3 * self.offset_std:.2g} ms) "
            "against the body's and "
            f"runs {1e6 * self.drift:+.1f} ppm fast (std {1e6 * self.drift_std:.2g} ppm)"
        )
