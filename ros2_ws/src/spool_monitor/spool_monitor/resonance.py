"""Resonance: the machine shakes near the natural frequency and the spool answers more than it is shaken."""

from __future__ import annotations

from dataclasses import dataclass, field

from spool_stream.quantity import Quantity, Validity

from .event import Condition, Event, Severity
from .spectrum import Line


@dataclass(slots=True)
class ResonanceDetector:
    """Judge the dominant line against the natural frequency.

    ``band``: relative distance of the line from the natural frequency that counts as near.
    ``amplification_on`` and ``amplification_off``: spool over body acceleration that raises and clears;
    at twice the raising value it is an alarm. ``minimum_body`` (m/s^2, peak): weaker lines are not judged.
    """

    band: float = 0.2
    amplification_on: float = 1.8
    amplification_off: float = 1.5
    minimum_body: float = 0.5
    condition: Condition = field(default_factory=lambda: Condition("resonance", on_delay=0.5, off_delay=1.0))

    def update(self, line: Line, natural_frequency: float) -> list[Event]:
        """Judge ``line`` against ``natural_frequency`` (Hz); return the event that follows, if any."""
        distance = abs(line.frequency / natural_frequency - 1.0)
        strong = line.body >= self.minimum_body
        indicated = None
        if strong and distance <= self.band and line.amplification >= self.amplification_on:
            alarm = line.amplification >= 2.0 * self.amplification_on
            indicated = Severity.ALARM if alarm else Severity.WARNING
        released = not strong or distance > 1.25 * self.band or line.amplification < self.amplification_off
        quantity = Quantity("amplification", "1", line.amplification, validity=Validity.VALID)
        message = (
            f"body shakes at {line.frequency:.1f} Hz, natural frequency {natural_frequency:.1f} Hz: spool "
            f"amplifies {line.amplification:.1f} times and moves "
            f"{1e3 * line.relative_displacement:.2f} mm in the body"
        )
        return self.condition.judge(
            line.stamp, indicated, released=released, cause="", quantity=quantity, message=message
        )

    def silent(self, stamp: int) -> list[Event]:
        """Take note that nothing shakes at ``stamp`` (ns); return the event that follows, if any."""
        return self.condition.judge(
            stamp,
            None,
            released=True,
            cause="",
            quantity=Quantity("amplification", "1"),
            message="the body is at rest",
        )
