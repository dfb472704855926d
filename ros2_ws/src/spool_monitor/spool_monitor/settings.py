"""Thresholds of one valve's monitor."""

from __future__ import annotations

from dataclasses import dataclass

from spool_stream.errors import InputError


@dataclass(frozen=True, slots=True)
class MonitorSettings:
    """Thresholds of one valve's monitor.

    ``natural_frequency`` (Hz) holds until the estimator knows better; 0: unknown, what needs it waits. The
    changes are those that must be found: relative for the viscous coefficient and the stiffness, in N for
    the Coulomb force; each alarm level is twice the warning. ``baseline_time`` (s) of valid estimates makes
    the start values. ``false_alarm_hours`` (h) is the mean time between false alarms of one parameter that
    noise alone may cause. ``gain_change`` (relative) and ``offset_change`` (m/s^2) are those of a channel
    that is at fault. ``stale_after`` (s) without data or estimates is reported.
    """

    natural_frequency: float = 0.0
    resonance_band: float = 0.15
    amplification_on: float = 1.8
    amplification_off: float = 1.5
    minimum_body: float = 0.5
    viscous_change: float = 0.2
    coulomb_change: float = 0.1
    stiffness_change: float = 0.1
    gain_change: float = 0.1
    offset_change: float = 0.5
    false_alarm_hours: float = 1000.0
    baseline_time: float = 15.0
    stale_after: float = 1.5

    def __post_init__(self) -> None:
        """Refuse thresholds that contradict each other.

        Raises:
            InputError: both are named.

        """
        if self.amplification_off >= self.amplification_on:
            raise InputError(
                f"amplification_off ({self.amplification_off:g}) must lie below amplification_on "
                f"({self.amplification_on:g}): what is raised would be cleared at once"
            )
