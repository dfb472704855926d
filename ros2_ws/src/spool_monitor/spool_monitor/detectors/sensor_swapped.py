"""Swapped channels: the relative motion gives energy away instead of taking it, as no passive valve does."""

from __future__ import annotations

from typing import ClassVar

from spool_core.uncertainty import Quantity, Validity

from spool_monitor.event import EventCause, Facts, Finding, Severity

from .base import MINIMUM_BODY, SIGNALS, Detector, Judgement, Moment
from .sensor_fault import sensor_fault

KIND = sensor_fault(EventCause("swapped", 604))


#: Damping against the reference below which the channels are exchanged, and above which they are not.
NEGATIVE, POSITIVE = -0.3, 0.0


class SensorSwapped(Detector):
    """The sign of the power that the relative motion takes."""

    name = "sensor_swapped"
    kind = KIND
    needs_valve = True
    looks_at = (SIGNALS,)
    rank = 3
    on_delay: ClassVar[float] = 1.5

    def update(self, moment: Moment) -> Finding | None:
        """Judge the window of ``moment``, if there is a new one."""
        if moment.signals is None:
            return None
        if moment.distrust:
            self.judgement, self.suspicious = Judgement.NOT_JUDGED, ""
            return None
        moving = moment.signals.relative_rms >= self.settings[MINIMUM_BODY]
        if not moving:
            self.judgement = Judgement.NOT_EXCITED
            self.suspicious = ""
            return None
        self.judgement = Judgement.JUDGED
        share = moment.signals.dissipation / moment.reference.damping
        self.suspicious = "the relative motion gives energy away" if share < 0.5 * NEGATIVE else ""
        dissipation = Quantity("dissipation", "1", share, validity=Validity.VALID)
        return Finding(
            moment.stamp,
            Severity.ALARM if share < NEGATIVE else None,
            share > POSITIVE,
            "swapped",
            dissipation,
            lambda: Facts.of(dissipation, NEGATIVE),
        )
